# SPDX-License-Identifier: Apache-2.0
"""Counts a recorded bag in one process, with no ROS running: `replay --direct`.

From Python::

    from stack_counter.bag.replay import count_bag
    result = count_bag("bags/demo", unit_volume=6.00488e-6)  # m3 of one part
    print(result.count, result.count_interval)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from stack_counter.bag.bag_views import BagViews
from stack_counter.config import Config, load_config
from stack_counter.counting import with_reasons
from stack_counter.errors import ScanError, ViewError
from stack_counter.files import config_path
from stack_counter.occupancy import OccupancyEstimator, make_estimator
from stack_counter.parts.catalogue import Part, resolve_part
from stack_counter.pipeline import StackCounter, count_stack
from stack_counter.segmentation.prompts import read_prompts
from stack_counter.segmentation.scan_labels import ScanLabels
from stack_counter.types import Reason, StackCount, StackVolume, View, ViewTally
from stack_counter.views.cycles import Cycle, CycleGrouper


@dataclass(frozen=True, eq=False)
class Replayed:
    """What the replay of a bag gives.

    Attributes:
        count: the final one.
        counts: `{stamp_ns, count, count_interval}`, one for each view used in continuous mode,
            one for each cycle in cycle mode.
        errors: of cycles that gave no count, one line each.
    """

    count: StackCount
    counts: list[dict[str, Any]] = field(default_factory=list)
    errors: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class MeasuredCycle:
    """V of one cycle of a rig's cameras, or the error, one line, that says why there is none."""

    volume: StackVolume | None
    error: str = ""


def count_bag(path: str | Path, *, part: str = "", unit_volume: float = 0.0,
              config: Config | None = None) -> StackCount:
    """Counts the stack of a recorded bag.

    Args:
        path: rosbag2 folder or .mcap file.
        part: name of a part of the catalogue; or else
        unit_volume: volume of one part, m3.
        config: settings; None: those of `config/stack_counter.yaml`.

    Raises:
        FileNotFoundError: there is no such path.
        PartError: neither part nor unit volume is given, or the part is unknown.
        BagError: the bag cannot be read, or lacks images.
        ScanError: the views do not suffice for a count.
        ConfigError, WeightsError: the settings, or files that they name, cannot be used.
    """
    config = config or load_config(config_path("stack_counter.yaml"))
    known = resolve_part(part, unit_volume, config.counter.part_catalogue)
    return replay_direct(Path(path), config, known).count


def replay_direct(path: Path, config: Config, part: Part, rate: float = 0.0,
                  on_view: Callable[[], None] = lambda: None, begin: float | None = None
                  ) -> Replayed:
    """Feeds a bag to `StackCounter` as fast as it can, or in real time times `rate`.

    Args:
        path: rosbag2 folder or .mcap file.
        config: settings; topics are fitted to the bag.
        part: what is in the bin.
        rate: 0, or the speed of the recording's clock.
        on_view: called after each view used, for progress.
        begin: when the command began (`time.perf_counter`): imports count as loading. None: now.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read, or lacks images.
        ScanError: the views do not suffice for a count.
        PartError: the part's files cannot be read.
        ConfigError, WeightsError: the settings, or files that they name, cannot be used.
    """
    # Load weights and settings.
    begin = time.perf_counter() if begin is None else begin
    estimator = make_estimator(config.counter)
    stack = StackCounter(config.reconstructor, part.unit_volume)
    loaded = time.perf_counter()
    if config.collector.mode == "cycle":
        return _replay_cycles(path, config, stack, part, estimator, on_view)

    # Add every view; in continuous mode count after each.
    confidence, counts = config.counter.confidence, []

    def after_view() -> None:
        on_view()
        if config.reconstructor.live:
            counts.append(count_entry(stack.count(part, estimator, confidence)))
    bag = BagViews(path, config.collector)
    volume = measure_scan(stack, bag, after_view, rate)

    # Count, and add where the time went.
    count = count_stack(volume, part, estimator, confidence)
    if bag.reader.truncated:
        count = with_reasons(count, Reason.BAG_TRUNCATED)
    return Replayed(replace(count, seconds={
        **count.seconds, "load": loaded - begin, "read": bag.reading_s,
        "total": time.perf_counter() - begin}), counts)


def measure_bag(path: Path, config: Config, unit_volume: float = 0.0,
                on_view: Callable[[], None] = lambda: None) -> StackVolume:
    """Measures V from all the views of a recorded scan.

    Args:
        path: rosbag2 folder or .mcap file.
        config: settings; topics are fitted to the bag.
        unit_volume: volume of one part, m3; 0 where it is not known.
        on_view: called after each view used, for progress.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read, or lacks images.
        ScanError: the bag gives no volume; in cycle mode: more than one.
        ConfigError, WeightsError: the settings, or files that they name, cannot be used.
    """
    stack = StackCounter(config.reconstructor, unit_volume)
    bag = BagViews(path, config.collector)
    if config.collector.mode == "cycle":
        cycles = measure_cycles(stack, bag, unit_volume, on_view)
        volumes = [cycle.volume for cycle in cycles if cycle.volume is not None]
        if len(volumes) != 1:
            raise ScanError(f"{path} holds {len(volumes)} cycles that give a volume; expected one")
        volume = volumes[0]
    else:
        volume = measure_scan(stack, bag, on_view)
    if bag.reader.truncated:
        volume = replace(volume, reasons=(*volume.reasons, Reason.BAG_TRUNCATED))
    return volume


def read_scan(path: Path, config: Config) -> list[View]:
    """All posed views of a recorded scan.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read, or lacks images.
        ConfigError: the rig file cannot be used.
        ScanError: there is no view.
    """
    bag = BagViews(path, config.collector)
    views = [view for _, view in bag]
    if not views:
        raise no_count_error("0 views; expected some", bag.assembler.tally,
                             bag.assembler.last_errors)
    return views


def check_prompts(path: Path, config: Config) -> None:
    """Refuses prompts that do not fit the first view of a bag, before any node is started.

    Raises:
        BagError: the bag cannot be read.
        ConfigError: the settings name no segmenter that takes prompts, or no file.
        WeightsError: the segmenter's weights cannot be loaded.
        PromptError: the prompts do not fit.
    """
    ScanLabels(config.reconstructor)  # raises what keeps the segmenter from working
    for _, first in BagViews(path, config.collector):
        read_prompts(config.reconstructor.prompts).check(first.intrinsics.width,
                                                         first.intrinsics.height)
        return


def measure_scan(stack: StackCounter, bag: BagViews, after_view: Callable[[], None],
                 rate: float = 0.0) -> StackVolume:
    """Measures V from all the views of a bag; its tally counts all images of the bag.

    Args:
        stack: started.
        bag: not yet read.
        after_view: called after each view used; a `ScanError` of it is ignored.
        rate: 0, or the speed of the recording's clock.

    Raises:
        BagError: a message of the bag does not decode.
        ScanError: the views do not suffice.
    """
    begin, first_ns, overrun = time.perf_counter(), None, bag.reader.overrun
    for _, view in bag:
        # Wait until the view is due.
        first_ns = view.stamp_ns if first_ns is None else first_ns
        if rate:
            due = begin + (view.stamp_ns - first_ns) * 1e-9 / rate
            time.sleep(max(due - time.perf_counter(), 0))
        # Leave out what the recorded scan had left out.
        if (view.camera, view.stamp_ns) in overrun:
            stack.skip_view(ViewError("overrun", "the recorded scan had no time for this view"))
            continue
        with suppress(ViewError, ScanError):  # counted in the tally, or nothing to count yet
            stack.add_view(view)
            after_view()
    # Join the counts of images that gave no view and of views that were refused.
    tally = bag.assembler.tally + stack.tally
    try:
        return replace(stack.volume(), views=tally)
    except ScanError as error:
        raise no_count_error(str(error), tally, bag.assembler.last_errors) from error


def measure_cycles(stack: StackCounter, bag: BagViews, unit_volume: float,
                   on_view: Callable[[], None]) -> Iterator[MeasuredCycle]:
    """Measures V of each cycle of a rig's cameras."""
    rig = bag.assembler.rig
    grouper = CycleGrouper([c.name for c in rig.cameras], rig.tolerance_s, rig.timeout_s,
                           live=False)
    for cycle in grouped_cycles(bag, grouper):
        stack.start(unit_volume)
        for name in grouper.cameras:
            with suppress(ViewError):  # counted in the tally
                if name in cycle.views:
                    stack.add_view(cycle.views[name])
                    on_view()
        try:
            yield MeasuredCycle(
                stack.volume().with_missing_cameras(grouper.missing_cameras(cycle))
            )
        except ScanError as error:
            yield MeasuredCycle(None, f"cycle at {cycle.stamp_ns} ns: {error}")


def grouped_cycles(views: Iterable[tuple[str, View]], grouper: CycleGrouper) -> Iterator[Cycle]:
    """Groups the views of a rig's cameras into cycles; a view that is late is left out."""
    for name, view in views:
        with suppress(ViewError):
            yield from grouper.add_view(name, view)
    yield from grouper.close_all()


def count_entry(count: StackCount) -> dict[str, Any]:
    """One entry of the JSON key `counts`."""
    missing = list(count.volume.missing_cameras)
    return {"stamp_ns": count.volume.stamp_ns, "count": count.count,
            "count_interval": list(count.count_interval),
            **({"missing_cameras": missing} if missing else {})}


def no_count_error(error: str, tally: ViewTally, hints: list[str]) -> ScanError:
    """The error of a bag that gives no count, with what became of its images."""
    return ScanError("; ".join([error, f"{tally.received} images in the bag, skipped "
                                       f"{tally.skipped}", *hints]))


def _replay_cycles(path: Path, config: Config, stack: StackCounter, part: Part,
                   estimator: OccupancyEstimator, on_view: Callable[[], None]) -> Replayed:
    """Counts each cycle of a rig's cameras; the last count is the result's."""
    bag, last = BagViews(path, config.collector), None
    counts, errors = [], []
    for cycle in measure_cycles(stack, bag, part.unit_volume, on_view):
        if cycle.volume is None:
            errors.append(cycle.error)
            continue
        last = count_stack(cycle.volume, part, estimator, config.counter.confidence)
        counts.append(count_entry(last))
    if last is None:
        raise no_count_error(errors[0] if errors else "0 cycles; expected one or more",
                             bag.assembler.tally, bag.assembler.last_errors)
    if bag.reader.truncated:
        last = with_reasons(last, Reason.BAG_TRUNCATED)
    return Replayed(last, counts, tuple(errors))
