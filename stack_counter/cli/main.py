"""The command `stack-counter`.

Exit codes: 0 a count (0 for an empty container is one); 2 the command line, part, configuration
or a path that is not there; 3 a bag that cannot give a count, with one line on stderr.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from tqdm import tqdm

from stack_counter import __version__
from stack_counter.cli.containers import add_container
from stack_counter.cli.parts import add_part
from stack_counter.config import Config, CounterConfig, build, load
from stack_counter.container.catalogue import configured_container
from stack_counter.counting import check_unit_volume
from stack_counter.errors import (
    BagError,
    ConfigError,
    PartError,
    ScanError,
    StackCounterError,
    WeightsError,
)
from stack_counter.files import config_path
from stack_counter.occupancy.baselines import make_estimator
from stack_counter.parts.catalogue import resolve_part

_USAGE, _NO_COUNT = 2, 3


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = _parser().parse_args(arguments)
    # Skipped views are counted in the result; one line on stderr is for what ends the command.
    logging.basicConfig(level=logging.ERROR, format="%(message)s", stream=sys.stderr)
    try:
        return options.run(options)
    except (ConfigError, PartError, WeightsError, FileNotFoundError) as error:
        return _fail(error, _USAGE)
    except (BagError, ScanError, StackCounterError) as error:
        return _fail(error, _NO_COUNT)
    except OSError as error:
        return _fail(error, _USAGE)
    except KeyboardInterrupt:
        return 130


def _fail(error: Exception, code: int) -> int:
    print(f"stack-counter: {' '.join(str(error).split())}", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """Can take its arguments from a module, loaded only when its command is used: some bring in
    libraries that take seconds."""

    module = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self.module:
            module, self.module = import_module(self.module), ""
            module.add_arguments(self)
            self.set_defaults(run=module.run)
        return super().parse_known_args(args, namespace)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="stack-counter", description=(
        "Counts identical parts stacked in a bin from a few posed views."))
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_replay(commands)
    run = commands.add_parser("run", help="start the three ROS 2 nodes and keep them running")
    run.add_argument("--config", type=Path, metavar="FILE", help="settings (ROS parameters)")
    run.set_defaults(run=_run)
    importer = commands.add_parser("import", help="nerfstudio folder to bag")
    importer.add_argument("scene", type=Path, help="folder with transforms.json")
    importer.add_argument("out", type=Path, help="bag to write (a new folder)")
    importer.set_defaults(run=_import)
    info = commands.add_parser("info", help="topics, frames, views and problems of a bag")
    info.add_argument("bag", type=Path)
    info.set_defaults(run=_info)
    add_container(commands)
    add_part(commands)
    _add_simulate(commands)
    commands.add_parser("train", help="train the gamma-network on simulated scenes"
                        ).module = "stack_counter.train.gamma"  # type: ignore[attr-defined]
    measures = commands.add_parser("evaluate", help="measure errors on simulated scenes")
    kinds = measures.add_subparsers(required=True, metavar="KIND")
    for kind, what in (("gamma", "of gamma, beside the baselines"),
                       ("count", "of the whole count and its interval"),
                       ("live", "of the running count while parts are taken out"),
                       ("parts", "of counts where the part's CAD file or a counted bin is known"),
                       ("template", "of v from pieces on a table"),
                       ("volume", "of V and the container"),
                       ("labels", "of the labels that segmenters give"),
                       ("images", "of V from pictures and labels, without depth"),
                       ("benchmark", "of V beside the published rule, and cost")):
        kinds.add_parser(kind, help=what).module = f"stack_counter.eval.{kind}"
    return parser


def _add_replay(commands: argparse._SubParsersAction) -> None:
    replay = commands.add_parser("replay", help="count the stack of a recorded bag")
    replay.add_argument("bag", type=Path, help="rosbag2 folder or .mcap file")
    part = replay.add_mutually_exclusive_group()
    part.add_argument("--part", default="", metavar="NAME", help="part of the catalogue")
    part.add_argument("--unit-volume-cm3", type=float, metavar="X", help="volume of one part")
    replay.add_argument("--catalogue", type=Path, metavar="FILE",
                        help="known parts; default: the configured ones, config/parts.yaml")
    replay.add_argument("--config", type=Path, metavar="FILE", help="settings (ROS parameters)")
    replay.add_argument("--json", type=Path, metavar="OUT", help="write the result here")
    replay.add_argument("--report", type=Path, metavar="DIR", help="write pictures here")
    how = replay.add_mutually_exclusive_group()
    how.add_argument("--nodes", dest="nodes", action="store_true", default=True,
                     help="through the three ROS 2 nodes (default)")
    how.add_argument("--direct", dest="nodes", action="store_false",
                     help="in one process without ROS")
    replay.add_argument("--live", action="store_true", help="a count after every view")
    replay.add_argument("--rate", type=float, default=0.0, metavar="X",
                        help="speed of the recording's clock; default: as fast as possible")
    replay.add_argument("--confidence", type=float, metavar="P", help="of the interval, e.g. 0.9")
    replay.add_argument("--estimator", metavar="NAME", help="what says gamma")
    replay.add_argument("--weights", type=Path, metavar="PATH", help="its weights (safetensors)")
    replay.add_argument("--prompts", type=Path, metavar="FILE",
                        help="points or boxes for the prompted segmenter")
    replay.set_defaults(run=_replay)


def _add_simulate(commands: argparse._SubParsersAction) -> None:
    simulate = commands.add_parser(
        "simulate", help="simulate piles of parts, or record simulated ones",
        description="Makes N scenes that are at rest in shards below DIR; `simulate bag` and "
                    "`simulate report` read them.")
    simulate.add_argument("--scenes", type=_positive, metavar="N")
    simulate.add_argument("--workers", type=_positive, default=1, metavar="W")
    simulate.add_argument("--seed", type=int, default=0, metavar="S")
    simulate.add_argument("--out", type=Path, metavar="DIR")
    simulate.add_argument("--plan", default="mixed", choices=("mixed", "shallow", "deep", "box",
                                                             "rig"),
                          help="containers and fills; box: as in the paper; rig: nine fills of "
                               "one container for each part")
    simulate.add_argument("--library", type=Path, metavar="FILE",
                          help="parts to take, an .npz of shapes, not the training families")
    simulate.set_defaults(run=_simulate)
    more = simulate.add_subparsers(metavar="bag | report")
    bag = more.add_parser("bag", help="record one scene as a robot cell would")
    bag.add_argument("scene", metavar="SCENE", help="DIR:INDEX, e.g. data/unseen:12")
    bag.add_argument("bag", type=Path, metavar="OUT", help="bag to write (a new folder)")
    bag.add_argument("--views", type=_positive, default=12, help="of the arc (default 12)")
    bag.add_argument("--picks", type=_positive, metavar="K",
                     help="a fixed camera sees K parts taken away, one after the other")
    bag.add_argument("--cycles", type=_positive, metavar="K",
                     help="a station of four fixed cameras sees K fills, one after the other")
    bag.add_argument("--spread", type=_positive, metavar="K",
                     help="no pile: K pieces of the scene's part apart on a table")
    bag.add_argument("--noise-seed", type=int, default=0, metavar="S",
                     help="of poses, noise and materials")
    bag.set_defaults(run=_simulate_bag)
    report = more.add_parser("report", help="one page with the statistics of a folder's scenes")
    report.add_argument("folder", type=Path, metavar="DIR")
    report.set_defaults(run=_simulate_report)


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"'{text}'; expected a whole number above 0")
    return int(text)


def _settings(options: argparse.Namespace) -> Config:
    """The settings file (or the shipped one) with the command line's own on top."""
    if options.rate < 0:
        raise ConfigError(f"--rate is {options.rate}; expected above 0")
    config = load(options.config or config_path("stack_counter.yaml"))
    chosen = {"confidence": options.confidence, "estimator": options.estimator,
              "weights": str(options.weights) if options.weights else None,
              "part_catalogue": str(options.catalogue.absolute()) if options.catalogue else None}
    values = {**config.counter.__dict__,
              **{key: value for key, value in chosen.items() if value is not None}}
    reconstructor = replace(config.reconstructor, live=options.live or config.reconstructor.live)
    if options.prompts is not None:
        by_sam2 = reconstructor.segmenter == "sam2"
        reconstructor = replace(reconstructor, prompts=str(options.prompts.absolute()),
                                segmenter="sam2" if by_sam2 else "prompted")
    counter, collector = build(CounterConfig, values), config.collector
    if options.catalogue is not None:
        collector = replace(collector, part_catalogue=counter.part_catalogue)
    return Config(collector, reconstructor, counter)


def _replay(options: argparse.Namespace) -> int:
    begin = time.perf_counter()
    config = _settings(options)
    part = options.part or config.counter.part
    given = 0.0 if options.part else config.counter.unit_volume_m3
    if options.unit_volume_cm3 is not None:
        part, given = "", check_unit_volume(options.unit_volume_cm3 * 1e-6)
    known = resolve_part(part, given, config.counter.part_catalogue)
    if not options.bag.exists():
        raise FileNotFoundError(f"no bag {options.bag}; expected a rosbag2 folder or .mcap file")
    if options.nodes:
        make_estimator(config.counter)  # or say why not; without nodes the replay itself does
    configured_container(config.reconstructor)  # or say why not
    if config.reconstructor.prompts:
        from stack_counter.bag.replay import check_prompts

        check_prompts(options.bag, config)
    from stack_counter.display.report import (
        as_dict,
        as_text,
        write_report,
    )  # after the cheap checks

    with tqdm(unit=" views", desc="replay", disable=not sys.stderr.isatty()) as bar:
        if options.nodes:
            from stack_counter.ros.node_replay import replay_nodes

            result = replay_nodes(options.bag, config, part, known.unit_volume, options.rate,
                                  lambda: bar.update() and None, begin)
        else:
            from stack_counter.bag.replay import replay_direct

            result = replay_direct(options.bag, config, known, options.rate,
                                   lambda: bar.update() and None, begin)
    for error in result.errors:
        print(f"stack-counter: {error}", file=sys.stderr)
    for entry in result.counts if config.collector.mode == "cycle" else ():
        low, high = entry["count_interval"]
        print(f"cycle at {entry['stamp_ns'] / 1e9:.3f} s: {entry['count']} parts, between {low} "
              f"and {high}" + (f", without {', '.join(entry['missing_cameras'])}"
                               if "missing_cameras" in entry else ""))
    print(as_text(result.count, _true_count(options.bag)))
    if options.json:
        text = json.dumps(as_dict(result.count, result.counts), indent=2)
        options.json.write_text(text + "\n")
    if options.report:
        write_report(options.report, result.count, result.counts)
    return 0


def _run(options: argparse.Namespace) -> int:
    path = options.config or config_path("stack_counter.yaml")
    load(path)  # or say why not, before anything starts
    from stack_counter.ros.supervisor import supervise

    return supervise(path)


def _true_count(bag: Path) -> int | None:
    """The count that a simulated recording states beside its data."""
    truth = bag / "truth.json"
    return int(json.loads(truth.read_text())["count"]) if truth.is_file() else None


def _import(options: argparse.Namespace) -> int:
    from stack_counter.bag.nerfstudio import import_scene

    print(import_scene(options.scene, options.out))
    return 0


def _info(options: argparse.Namespace) -> int:
    from stack_counter.bag.info import describe_bag

    print(describe_bag(options.bag, load(config_path("stack_counter.yaml")).collector))
    return 0


def _simulate(options: argparse.Namespace) -> int:
    if options.scenes is None or options.out is None:
        raise ConfigError("simulate needs --scenes N and --out DIR")
    from stack_counter.sim.dataset import simulate

    simulate(options.out, options.scenes, options.workers, options.seed, options.plan,
             options.library)
    return 0


def _simulate_bag(options: argparse.Namespace) -> int:
    from stack_counter.sim.camera.bags import (
        write_picks_bag,
        write_scene_bag,
        write_spread_bag,
        write_station_bag,
    )
    from stack_counter.sim.scenes.shards import find_scene

    scene = find_scene(options.scene)
    if options.picks:
        write_picks_bag(scene, options.bag, options.picks, options.noise_seed)
    elif options.cycles:
        write_station_bag(scene, options.bag, options.cycles, options.noise_seed)
    elif options.spread:
        write_spread_bag(scene, options.bag, options.spread, options.views, options.noise_seed)
    else:
        write_scene_bag(scene, options.bag, options.views, options.noise_seed)
    where = "a table" if options.spread else f"container {scene.container.kind}"
    print(f"{options.bag}: {options.spread or len(scene.poses)} parts of "
          f"{scene.shape.unit_volume * 1e6:.6g} cm3 ({scene.shape.family}), {where}")
    return 0


def _simulate_report(options: argparse.Namespace) -> int:
    from stack_counter.sim.report import write_report

    print(write_report(options.folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
