# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter replay`: counts the stack of a recorded bag."""

from __future__ import annotations

import argparse
import json
import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stack_counter.cli.arrangement import (
    add_arrangement_argument,
    load_arranged_shape,
    simulate_arrangement,
)
from stack_counter.cli.common import (
    add_config_argument,
    add_time_arguments,
    chosen_time_range,
    positive_number,
    require_bag,
)
from stack_counter.config import Config, CounterConfig, build_section, load_config
from stack_counter.errors import BagError, ConfigError, PartError
from stack_counter.files import config_path
from stack_counter.tasks.progress import progress_bar
from stack_counter.types import PartRequest

if TYPE_CHECKING:
    from stack_counter.bag.replayed import Replayed
    from stack_counter.parts.catalogue import Part
    from stack_counter.sim import Shape


def add_replay(commands: argparse._SubParsersAction) -> None:
    """Adds `replay` to the commands of the command line."""
    replay = commands.add_parser("replay", help="count the stack of a recorded bag")
    replay.add_argument("bag", type=Path, help="rosbag2 folder, or a file: .mcap, .db3 or, "
                                               "of ROS 1, .bag; each also as .zstd")
    part = replay.add_mutually_exclusive_group()
    part.add_argument("--part", default="", metavar="NAME", help="part of the catalogue")
    part.add_argument("--unit-volume-cm3", type=float, metavar="X", help="volume of one part")
    replay.add_argument("--part-size-mm", type=_part_size, metavar="XxYxZ",
                        help="sides of the box around one part, in any order, as 32x16x10")
    replay.add_argument("--weight-kg", type=float, metavar="X",
                        help="what the scale under the container shows, with the container; "
                             "default: as weight_topic of the settings says")
    replay.add_argument("--catalogue", type=Path, metavar="FILE",
                        help="known parts; default: the configured ones, config/parts.yaml")
    add_config_argument(replay)
    replay.add_argument("--json", type=Path, metavar="OUT", help="write the result here")
    replay.add_argument("--json-schema", action=_PrintSchema, nargs=0,
                        help="print the JSON schema of that, and do nothing else")
    replay.add_argument("--report", type=Path, metavar="DIR",
                        help="write the report page, its model and its pictures here")
    add_arrangement_argument(replay)
    how = replay.add_mutually_exclusive_group()
    how.add_argument("--nodes", dest="nodes", action="store_true", default=True,
                     help="through the three ROS 2 nodes (default)")
    how.add_argument("--direct", dest="nodes", action="store_false",
                     help="in one process without ROS")
    replay.add_argument("--live", action="store_true", help="a count after every view")
    replay.add_argument("--rate", type=float, default=0.0, metavar="X",
                        help="speed of the recording's clock; default: as fast as possible")
    add_time_arguments(replay)
    replay.add_argument("--confidence", type=float, metavar="P", help="of the interval, e.g. 0.9")
    estimators = CounterConfig.__dataclass_fields__["estimator"].metadata["choices"]
    replay.add_argument("--estimator", metavar="NAME",
                        help=f"what estimates gamma: {', '.join(estimators)}")
    replay.add_argument("--weights", type=Path, metavar="PATH", help="its weights (safetensors)")
    replay.add_argument("--prompts", type=Path, metavar="FILE",
                        help="points or boxes for the prompted segmenter")
    replay.set_defaults(run=_replay)


def _part_size(text: str) -> tuple[float, ...]:
    """Argument type: three lengths in mm with x between them; returns metres."""
    sides = text.lower().split("x")
    if len(sides) != 3:
        raise argparse.ArgumentTypeError(f"'{text}'; expected three sides in mm, as 32x16x10")
    return tuple(1e-3 * positive_number(side) for side in sides)


class _PrintSchema(argparse.Action):
    """Prints the schema of the JSON and exits, as `--version` does: no bag is needed."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Prints and exits."""
        from stack_counter.display.result_schema import result_schema

        print(json.dumps(result_schema(), indent=2))
        parser.exit()


def _replay(options: argparse.Namespace) -> int:
    begin = time.perf_counter()
    # Refuse at once what cannot be counted, with what that takes: help is to load none of it.
    config = _settings(options)
    part = _part(options, config)
    shape = load_arranged_shape(options, config, part)
    chosen_time_range(options)  # raises what is wrong with it
    require_bag(options.bag)
    true_count = _true_count(options.bag)
    if options.nodes:
        from stack_counter.occupancy import make_estimator

        make_estimator(config.counter)  # raises what the counter could not load
    if config.reconstructor.container:
        from stack_counter.container.catalogue import configured_container

        configured_container(config.reconstructor)  # raises what the reconstructor could not load
    if config.reconstructor.prompts:
        from stack_counter.bag.replay import check_prompts

        check_prompts(options.bag, config, chosen_time_range(options))
    # Count, then print and write.
    results = _count(options, config, part, begin)
    _print_lines(config, results)
    if config.reconstructor.regions:
        _show_regions(options, config, part, results)
    else:
        _show_result(options, config, part, results[0], shape, true_count)
    return 0


def _settings(options: argparse.Namespace) -> Config:
    """The settings file (or the shipped one) with the command line's own on top."""
    if options.rate < 0:
        raise ConfigError(f"--rate is {options.rate}; expected above 0")
    config = load_config(options.config or config_path("stack_counter.yaml"))
    # Settings of the counter.
    chosen = {"result_log": "",  # of what the cell counts, not of what is played again
              "weight_kg": options.weight_kg, "confidence": options.confidence,
              "estimator": options.estimator,
              "weights": str(options.weights) if options.weights else None,
              "part_catalogue": str(options.catalogue.absolute()) if options.catalogue else None}
    counter = build_section(CounterConfig, {
        **config.counter.__dict__,
        **{key: value for key, value in chosen.items() if value is not None}})
    # Settings of the reconstructor: prompts choose a segmenter that takes them.
    reconstructor = replace(config.reconstructor, live=options.live or config.reconstructor.live)
    if options.prompts is not None:
        segmenter = "sam2" if reconstructor.segmenter == "sam2" else "prompted"
        reconstructor = replace(reconstructor, prompts=str(options.prompts.absolute()),
                                segmenter=segmenter)
    # The collector looks parts up in the same catalogue.
    collector = config.collector
    if options.catalogue is not None:
        collector = replace(collector, part_catalogue=counter.part_catalogue)
    return Config(collector, reconstructor, counter)


def _part(options: argparse.Namespace, config: Config) -> Part:
    """The part that the command line, else the settings name."""
    from stack_counter.counting import check_unit_volume
    from stack_counter.parts.part_lookup import configured_part, resolve_part

    request = configured_part(config.counter)
    if options.unit_volume_cm3 is not None:
        request = PartRequest("", check_unit_volume(options.unit_volume_cm3 * 1e-6))
    elif options.part:
        request = PartRequest(options.part)
    if options.part_size_mm is not None:
        request = replace(request, outer_size_m=options.part_size_mm)
    part = resolve_part(request, config.counter.part_catalogue)
    if options.weight_kg is not None and part.piece_weight is None:
        raise PartError(f"--weight-kg with part '{part.name}', of which the catalogue has no "
                        "piece_weight_g; expected one: weigh some pieces and enter their mean")
    return part


def _count(options: argparse.Namespace, config: Config, part: Part, begin: float
           ) -> list[Replayed]:
    """Replays the bag through the nodes, or in this process."""
    time_range = chosen_time_range(options)
    # Without a terminal stderr is for programs, which read there why there is no count.
    with progress_bar("replay", "views") if sys.stderr.isatty() \
            else nullcontext(lambda: None) as on_view:
        if options.nodes:
            from stack_counter.ros.node_replay import replay_nodes

            request = PartRequest(part.name, part.unit_volume,
                                  part.outer_size_m or PartRequest().outer_size_m)
            return replay_nodes(options.bag, config, request, options.rate, on_view, begin,
                                time_range)
        from stack_counter.bag.replay import replay_direct

        return replay_direct(options.bag, config, part, options.rate, on_view, begin, time_range)


def _print_lines(config: Config, results: list[Replayed]) -> None:
    """Prints notes and what gave no count to stderr, and a row for every cycle."""
    for note in results[0].notes:
        print(f"stack-counter: {note}", file=sys.stderr)
    for result in results:
        of_region = f"region {result.region}: " if result.region else ""
        if result.error:
            print(f"stack-counter: {of_region}{result.error}", file=sys.stderr)
        for entry in result.counts if config.collector.mode == "cycle" else ():
            row = of_region + _cycle_text(entry)
            print(row)
            if "error" in entry:
                print(f"stack-counter: {row}", file=sys.stderr)


def _cycle_text(entry: dict[str, Any]) -> str:
    """Returns the row of one cycle, an entry of `Replayed.counts`."""
    without = f", without {', '.join(entry['missing_cameras'])}" if "missing_cameras" in entry \
        else ""
    if "error" in entry:
        said = f"no count{without}: {entry['error']}"
    else:
        low, high = entry["count_interval"]
        said = f"{entry['count']} parts, between {low} and {high}{without}"
    return f"cycle at {entry['stamp_ns'] / 1e9:.3f} s: {said}"


def _show_result(options: argparse.Namespace, config: Config, part: Part, result: Replayed,
                 shape: Shape | None, true_count: int | None) -> None:
    """Prints and writes the one result of a scan without named regions.

    `shape`: of the part where an arrangement is asked for; the report is there before it is.
    `true_count`: where the bag states one.
    """
    from stack_counter.display.page.subject import report_subject
    from stack_counter.display.report import as_dict, as_text, write_report

    count = result.count
    assert count is not None  # for the type checker: without one there is a ScanError
    print(as_text(count, true_count))
    if options.json:
        options.json.write_text(json.dumps(as_dict(count, result.counts), indent=2) + "\n")
    if options.report:
        subject = report_subject(options.bag, config, part.name, count, true_count)
        write_report(options.report, count, result.counts, subject)
        if shape and (arrangement := simulate_arrangement(shape, part, count)):
            write_report(options.report, count, result.counts,
                         replace(subject, arrangement=arrangement))


def _show_regions(options: argparse.Namespace, config: Config, part: Part,
                  results: list[Replayed]) -> None:
    """Prints the table of all regions, and writes their results."""
    from stack_counter.cli.region_table import (
        regions_as_dict,
        regions_as_text,
        write_region_reports,
    )
    from stack_counter.display.page.subject import report_subject

    print(regions_as_text(results))
    if options.json:
        options.json.write_text(json.dumps(regions_as_dict(results), indent=2) + "\n")
    if options.report:
        write_region_reports(options.report, results,
                             partial(report_subject, options.bag, config, part.name))


def _true_count(bag: Path) -> int | None:
    """The count that a simulated recording states beside its data; BagError: it states none."""
    truth = bag / "truth.json"
    try:
        return int(json.loads(truth.read_text())["count"]) if truth.is_file() else None
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise BagError(f"{truth} is malformed at {error}; expected a JSON object with 'count': "
                       "mend it or remove it") from error
