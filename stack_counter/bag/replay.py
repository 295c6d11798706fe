"""Counts a recorded bag in one process, with no ROS running: `replay --direct`; and learns an
empty container from one: `container teach`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

from stack_counter.bag.reader import BagReader, fit_rig, read_views
from stack_counter.config import CollectorConfig, Config
from stack_counter.container.catalogue import TaughtContainer, taught_from
from stack_counter.counting import with_reasons
from stack_counter.errors import ScanError, ViewError
from stack_counter.occupancy.baselines import OccupancyEstimator, make_estimator
from stack_counter.parts.catalogue import Part
from stack_counter.pipeline import StackCounter, count_stack
from stack_counter.segmentation.prompts import read_prompts
from stack_counter.segmentation.scan_labels import ScanLabels
from stack_counter.types import Reason, StackCount, StackVolume, View, ViewTally
from stack_counter.views.cycles import Cycle, CycleGrouper
from stack_counter.views.rig import RigAssembler, load_rig


@dataclass(frozen=True)
class Replayed:
    """The final count, and one `{stamp_ns, count, count_interval}` a view in continuous mode, a
    cycle in cycle mode."""

    count: StackCount
    counts: list[dict[str, Any]] = field(default_factory=list)
    errors: tuple[str, ...] = ()  # of cycles that gave no count


def count_entry(count: StackCount) -> dict[str, Any]:
    """One entry of the JSON key `counts`."""
    missing = list(count.volume.missing_cameras)
    return {"stamp_ns": count.volume.stamp_ns, "count": count.count,
            "count_interval": list(count.count_interval),
            **({"missing_cameras": missing} if missing else {})}


def no_count(error: str, tally: ViewTally, hints: list[str]) -> ScanError:
    """The error of a bag that gives no count, with what became of its images."""
    return ScanError("; ".join([error, f"{tally.received} images in the bag, skipped "
                                       f"{tally.skipped}", *hints]))


def check_prompts(path: Path, config: Config) -> None:
    """Refuses prompts that do not fit the first view of a bag, before any node is started.

    Raises:
        BagError: the bag cannot be read.
        ConfigError, WeightsError: as `ScanLabels`.
        PromptError: the prompts do not fit.
    """
    ScanLabels(config.reconstructor)  # or say why not
    for _, first in read_views(*_assembled(path, config.collector)):
        read_prompts(config.reconstructor.prompts).check(first.intrinsics.width,
                                                         first.intrinsics.height)
        return


def replay_direct(path: Path, config: Config, part: Part, rate: float,
                  on_view: Callable[[], None], begin: float) -> Replayed:
    """Feeds a bag to `StackCounter` as fast as it can, or in real time times `rate`.

    Args:
        path: rosbag2 folder or .mcap file.
        config: settings; topics are fitted to the bag.
        part: what is in the bin.
        rate: 0, or the speed of the recording's clock.
        on_view: called after each view used, for progress.
        begin: when the command began (`time.perf_counter`): imports count as loading.

    Raises:
        BagError, ScanError, ConfigError, WeightsError, PartError: see there.
    """
    estimator = make_estimator(config.counter)
    stack = StackCounter(config.reconstructor, part.unit_volume)
    loaded = time.perf_counter()
    confidence, counts = config.counter.confidence, []

    if config.collector.mode == "cycle":
        return _replay_cycles(path, config, stack, part, estimator, on_view)

    def after_view() -> None:
        on_view()
        if config.reconstructor.live:
            counts.append(count_entry(stack.count(part, estimator, confidence)))
    volume, truncated = _volume(stack, path, config.collector, rate, after_view)
    count = count_stack(volume, part, estimator, confidence)
    if truncated:
        count = with_reasons(count, Reason.BAG_TRUNCATED)
    total = time.perf_counter() - begin
    spent = sum(count.seconds.values())
    return Replayed(replace(count, seconds={
        **count.seconds, "load": loaded - begin, "read": total - spent - (loaded - begin),
        "total": total}), counts)


def teach(path: Path, config: Config, on_view: Callable[[], None]) -> TaughtContainer:
    """What the recording of an empty container says of its walls and floor.

    Args:
        path: rosbag2 folder or .mcap file.
        config: settings; topics are fitted to the bag; an already taught container is not used.
        on_view: called after each view used, for progress.

    Raises:
        BagError, ConfigError: see there.
        ScanError: no container, one that is not empty, or too few views.
    """
    stack = StackCounter(replace(config.reconstructor, container="", live=False))
    volume, _ = _volume(stack, path, config.collector, 0.0, on_view)
    return taught_from(volume, f"{date.today()} from {path.resolve().name}")


def bag_volume(path: Path, config: Config, unit_volume: float, on_view: Callable[[], None]
               ) -> StackVolume:
    """V of all the views of a recorded scan.

    Args:
        path: rosbag2 folder or .mcap file.
        config: settings; topics are fitted to the bag.
        unit_volume: of one part, m3.
        on_view: called after each view used, for progress.

    Raises:
        BagError, ConfigError, WeightsError: see there.
        ScanError: the bag gives no volume; in cycle mode: more than one.
    """
    stack = StackCounter(config.reconstructor, unit_volume)
    if config.collector.mode == "cycle":
        reader, assembler = _assembled(path, config.collector)
        volumes = [scan for scan in _cycles(reader, assembler, stack, unit_volume, on_view)
                   if isinstance(scan, StackVolume)]
        if len(volumes) != 1:
            raise ScanError(f"{path} holds {len(volumes)} cycles that give a volume; expected one")
        volume, truncated = volumes[0], reader.truncated
    else:
        volume, truncated = _volume(stack, path, config.collector, 0.0, on_view)
    if truncated:
        volume = replace(volume, reasons=(*volume.reasons, Reason.BAG_TRUNCATED))
    return volume


def bag_views(path: Path, config: Config) -> list[View]:
    """All posed views of a recorded scan.

    Raises:
        BagError, ConfigError: see there.
        ScanError: there is none.
    """
    reader, assembler = _assembled(path, config.collector)
    views = [view for _, view in read_views(reader, assembler)]
    if not views:
        raise no_count("0 views; expected some", assembler.tally, assembler.last_errors)
    return views


def _volume(stack: StackCounter, path: Path, collector: CollectorConfig, rate: float,
            after_view: Callable[[], None]) -> tuple[StackVolume, bool]:
    """V of all the views of a bag with their tally, and whether the bag is cut short."""
    begin = time.perf_counter()
    reader, assembler = _assembled(path, collector)
    first_ns, overrun = None, reader.overrun
    for _, view in read_views(reader, assembler):
        first_ns = view.stamp_ns if first_ns is None else first_ns
        if rate:
            due = begin + (view.stamp_ns - first_ns) * 1e-9 / rate
            time.sleep(max(due - time.perf_counter(), 0))
        if (view.camera, view.stamp_ns) in overrun:
            stack.skip(ViewError("overrun", "the recorded scan had no time for this view"))
            continue
        try:
            stack.add_view(view)
            after_view()
        except (ViewError, ScanError):
            continue  # counted in the tally, or nothing to count yet
    tally = assembler.tally + stack.tally
    try:
        return replace(stack.volume(), views=tally), reader.truncated
    except ScanError as error:
        raise no_count(str(error), tally, assembler.last_errors) from error


def _replay_cycles(path: Path, config: Config, stack: StackCounter, part: Part,
                   estimator: OccupancyEstimator, on_view: Callable[[], None]) -> Replayed:
    """Counts each cycle of a rig's cameras; the last count is the result's."""
    reader, assembler = _assembled(path, config.collector)
    last, counts, errors = None, [], []
    for volume in _cycles(reader, assembler, stack, part.unit_volume, on_view):
        if isinstance(volume, str):
            errors.append(volume)
            continue
        last = count_stack(volume, part, estimator, config.counter.confidence)
        counts.append(count_entry(last))
    if last is None:
        raise no_count(errors[0] if errors else "0 cycles; expected one or more",
                       assembler.tally, assembler.last_errors)
    if reader.truncated:
        last = with_reasons(last, Reason.BAG_TRUNCATED)
    return Replayed(last, counts, tuple(errors))


def _assembled(path: Path, collector: CollectorConfig) -> tuple[BagReader, RigAssembler]:
    """A bag, and what makes views of its messages."""
    reader = BagReader(path)
    return reader, RigAssembler(fit_rig(load_rig(collector), reader.topics), live=False)


def _cycles(reader: BagReader, assembler: RigAssembler, stack: StackCounter, unit_volume: float,
            on_view: Callable[[], None]) -> Iterator[StackVolume | str]:
    """V of each cycle of a rig's cameras, or why there is none."""
    rig = assembler.rig
    former = CycleGrouper([c.name for c in rig.cameras], rig.tolerance_s, rig.timeout_s,
                          live=False)
    for cycle in formed(read_views(reader, assembler), former):
        stack.start(unit_volume)
        for name in former.cameras:
            with suppress(ViewError):  # counted in the tally
                if name in cycle.views:
                    stack.add_view(cycle.views[name])
                    on_view()
        try:
            yield stack.volume().without(former.missing(cycle))
        except ScanError as error:
            yield f"cycle at {cycle.stamp_ns} ns: {error}"


def formed(views: Iterable[tuple[str, View]], former: CycleGrouper) -> Iterator[Cycle]:
    """The cycles that views of a rig's cameras make; one that is late is left out."""
    for name, view in views:
        with suppress(ViewError):
            yield from former.add(name, view)
    yield from former.flush()
