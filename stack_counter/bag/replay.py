# SPDX-License-Identifier: Apache-2.0
"""Counts a recorded bag in one process, with no ROS running: `replay --direct`.

From Python::

    from stack_counter.bag.replay import count_bag
    result = count_bag("bags/demo", unit_volume=6.00488e-6)  # m3 of one part
    print(result.count, result.count_interval)
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stack_counter.bag.bag_scale import BagScale
from stack_counter.bag.bag_views import BagViews, with_scale_of_bag
from stack_counter.bag.feeding import feed_cycles, feed_scan
from stack_counter.bag.replayed import (
    Replayed,
    count_entry,
    failed_cycle_entry,
    no_count_line,
    replayed_cycles,
    require_count,
)
from stack_counter.bag.time_range import WHOLE_BAG, TimeRange
from stack_counter.config import Config, load_config
from stack_counter.counting import with_reasons
from stack_counter.errors import ConfigError, ScanError
from stack_counter.files import config_path
from stack_counter.occupancy import OccupancyEstimator, make_estimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.part_lookup import resolve_part
from stack_counter.pipeline import StackCounter
from stack_counter.region_counters import RegionCounters, RegionVolume
from stack_counter.segmentation.prompts import read_prompts
from stack_counter.segmentation.scan_labels import ScanLabels
from stack_counter.stack_count import count_stack
from stack_counter.types import PartRequest, Reason, StackCount, StackVolume, View, ViewTally
from stack_counter.visible_parts.finder import VisiblePartFinder, make_finder
from stack_counter.weighing.joined_count import Weighing


@dataclass(frozen=True, eq=False)
class _CountSettings:
    """What a measured volume is counted by."""

    part: Part
    estimator: OccupancyEstimator
    confidence: float
    weigh: Callable[[StackVolume], Weighing | None]
    finder: VisiblePartFinder | None

    def count(self, measured: RegionVolume) -> StackCount:
        """Raises ScanError: there is no volume, or nothing to read gamma from."""
        if measured.volume is None:
            raise ScanError(measured.error)
        return count_stack(measured.volume, self.part, self.estimator, self.confidence,
                           self.weigh(measured.volume), self.finder)


def count_bag(path: str | Path, *, part: str = "", unit_volume: float = 0.0,
              part_size_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
              config: Config | None = None) -> StackCount:
    """Counts the stack of a recorded bag.

    Args:
        path: rosbag2 folder, or a file of a recording.
        part: name of a part of the catalogue; or else
        unit_volume: volume of one part, m3.
        part_size_m: sides of the box around one part, metres; zeros: not known.
        config: settings; None: those of `config/stack_counter.yaml`.

    Raises:
        FileNotFoundError: there is no such path.
        PartError: neither part nor unit volume is given, or the part is unknown.
        BagError: the bag cannot be read, or lacks images.
        ScanError: the views do not suffice for a count.
        ConfigError, WeightsError: the settings, or files that they name, cannot be used; or the
            settings name regions, of which `replay_direct` gives a count each.
    """
    config = config or load_config(config_path("stack_counter.yaml"))
    if config.reconstructor.regions:
        raise ConfigError("the settings name regions; expected none for one count: replay_direct "
                          "gives one for each of them")
    known = resolve_part(PartRequest(part, unit_volume, part_size_m),
                         config.counter.part_catalogue)
    count = replay_direct(Path(path), config, known)[0].count
    assert count is not None  # for the type checker: without one there is a ScanError
    return count


def replay_direct(path: Path, config: Config, part: Part, rate: float = 0.0,
                  on_view: Callable[[], None] = lambda: None, begin: float | None = None,
                  time_range: TimeRange = WHOLE_BAG,
                  estimator: OccupancyEstimator | None = None) -> list[Replayed]:
    """Feeds a bag to `RegionCounters` as fast as it can, or in real time times `rate`.

    Args:
        path: rosbag2 folder, or a file of a recording.
        config: settings; topics are fitted to the bag.
        part: what is in the bin.
        rate: 0, or the speed of the recording's clock.
        on_view: called after each view used, for progress.
        begin: when the command began (`time.perf_counter`): imports count as loading. None: now.
        time_range: the part of the bag whose images are used.
        estimator: made before, by the same settings; None: it is made.

    Returns:
        One result for each named region, at least one of them with a count; one without names.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read, or lacks images.
        ScanError: the views do not suffice for a count.
        PartError: the part's files cannot be read.
        ConfigError, WeightsError: the settings, or files that they name, cannot be used.
    """
    # Load weights and settings.
    begin = time.perf_counter() if begin is None else begin
    bag = BagViews(path, config.collector, time_range)
    config = with_scale_of_bag(config, bag.reader)
    settings = _CountSettings(part, estimator or make_estimator(config.counter),
                              config.counter.confidence, _scale_of(bag, config),
                              make_finder(config.counter.visible_parts_weights,
                                          config.counter.visible_part_poses))
    counters = RegionCounters(config.reconstructor, part.unit_volume)
    loaded = time.perf_counter()
    # Count, and add where the time went.
    results = _replay_cycles(bag, counters, settings, on_view) \
        if config.collector.mode == "cycle" \
        else _replay_scan(bag, counters, settings, on_view, config.reconstructor.live, rate)
    seconds = {"load": loaded - begin, "read": bag.reading_s, "total": time.perf_counter() - begin}
    return [replace(result, notes=tuple(bag.notes), count=result.count and replace(
        result.count, seconds={**result.count.seconds, **seconds}))
        for result in require_count(results)]


def _scale_of(bag: BagViews, config: Config) -> Callable[[StackVolume], Weighing | None]:
    """Returns what weighs a volume: when its last view came, or the scan as a whole at its end."""
    scale = BagScale(bag.reader, config.counter)
    if config.reconstructor.live or config.collector.mode == "cycle":
        return lambda volume: scale.weighing_at(volume.stamp_ns)
    end_ns = bag.reader.last_time_ns(set(bag.assembler.color_topics()))
    return lambda volume: scale.weighing_at(end_ns)


def _replay_scan(bag: BagViews, counters: RegionCounters, settings: _CountSettings,
                 on_view: Callable[[], None], live: bool, rate: float) -> list[Replayed]:
    """Counts every region from all views of a bag; in live mode after each view as well."""
    entries: dict[str, list[dict[str, Any]]] = {name: [] for name in counters.counters}

    def after_view() -> None:
        on_view()
        for measured in counters.volumes() if live else ():
            with suppress(ScanError):  # nothing to count yet
                entries[measured.region].append(count_entry(settings.count(measured)))

    feed_scan(counters, bag, after_view, rate)
    results = []
    for measured in counters.volumes():
        tally = bag.assembler.tally + measured.tally
        try:
            count = _with_bag(settings.count(measured), bag, tally)
            results.append(Replayed(count, entries[measured.region], region=measured.region))
        except ScanError as error:
            line = no_count_line(str(error), tally, bag.hints)
            results.append(Replayed(None, entries[measured.region], line, measured.region))
    return results


def _replay_cycles(bag: BagViews, counters: RegionCounters, settings: _CountSettings,
                   on_view: Callable[[], None]) -> list[Replayed]:
    """Counts every region in each cycle of a rig's cameras; the last count is the result's."""
    last: dict[str, StackCount] = {}
    entries: dict[str, list[dict[str, Any]]] = {name: [] for name in counters.counters}
    for cycle in feed_cycles(counters, bag, settings.part.unit_volume, on_view):
        for measured in counters.volumes():
            name = measured.region
            try:
                count = settings.count(measured.with_missing_cameras(cycle.missing_cameras))
            except ScanError as error:
                entries[name].append(failed_cycle_entry(cycle.stamp_ns, str(error),
                                                        cycle.missing_cameras))
                continue
            last[name] = _with_bag(count, bag)
            entries[name].append(count_entry(count))
    return [replayed_cycles(name, entries[name], last.get(name), bag.assembler.tally,
                            bag.hints) for name in counters.counters]


def _with_bag(count: StackCount, bag: BagViews, tally: ViewTally | None = None) -> StackCount:
    """The count with the tally of all images of the bag, and whether that is cut short."""
    if tally is not None:
        count = replace(count, volume=replace(count.volume, views=tally))
    return with_reasons(count, Reason.BAG_TRUNCATED) if bag.reader.truncated else count


def measure_bag(path: Path, config: Config, unit_volume: float = 0.0,
                on_view: Callable[[], None] = lambda: None, time_range: TimeRange = WHOLE_BAG
                ) -> StackVolume:
    """Measures V from all the views of a recorded scan.

    Args:
        path: rosbag2 folder, or a file of a recording.
        config: settings; topics are fitted to the bag.
        unit_volume: volume of one part, m3; 0 where it is not known.
        on_view: called after each view used, for progress.
        time_range: the part of the bag whose images are used.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read, or lacks images.
        ScanError: the bag gives no volume; in cycle mode: more than one.
        ConfigError, WeightsError: the settings, or files that they name, cannot be used.
    """
    bag = BagViews(path, config.collector, time_range)
    config = with_scale_of_bag(config, bag.reader)
    stack = StackCounter(config.reconstructor, unit_volume)
    if config.collector.mode == "cycle":
        volumes = []
        for cycle in feed_cycles(stack, bag, unit_volume, on_view):
            with suppress(ScanError):
                volumes.append(stack.volume().with_missing_cameras(cycle.missing_cameras))
        if len(volumes) != 1:
            raise ScanError(f"{path} holds {len(volumes)} cycles that give a volume; expected one")
        volume = volumes[0]
    else:
        volume = measure_scan(stack, bag, on_view)
    if bag.reader.truncated:
        volume = replace(volume, reasons=(*volume.reasons, Reason.BAG_TRUNCATED))
    return volume


def read_scan(path: Path, config: Config, time_range: TimeRange = WHOLE_BAG) -> list[View]:
    """All posed views of a recorded scan, or of a part of it.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read, or lacks images.
        ConfigError: the rig file cannot be used.
        ScanError: there is no view.
    """
    bag = BagViews(path, config.collector, time_range)
    views = [view for _, view in bag]
    if not views:
        raise ScanError(no_count_line("0 views; expected some", bag.assembler.tally,
                                      bag.hints))
    return views


def check_prompts(path: Path, config: Config, time_range: TimeRange = WHOLE_BAG) -> None:
    """Refuses prompts that do not fit the first view of a bag, before any node is started.

    Args:
        path: rosbag2 folder, or a file of a recording.
        config: settings; topics are fitted to the bag.
        time_range: the part of the bag whose images are used.

    Raises:
        BagError: the bag cannot be read.
        ConfigError: the settings name no segmenter that takes prompts, or no file.
        WeightsError: the segmenter's weights cannot be loaded.
        PromptError: the prompts do not fit.
    """
    ScanLabels(config.reconstructor)  # raises what keeps the segmenter from working
    for _, first in BagViews(path, config.collector, time_range):
        read_prompts(config.reconstructor.prompts).check(first.intrinsics.width,
                                                         first.intrinsics.height)
        return


def measure_scan(stack: StackCounter, bag: BagViews, after_view: Callable[[], None]
                 ) -> StackVolume:
    """Measures V from all the views of a bag; its tally counts all images of the bag.

    Args:
        stack: started.
        bag: not yet read.
        after_view: called after each view used.

    Raises:
        BagError: a message of the bag does not decode.
        ScanError: the views do not suffice.
    """
    feed_scan(stack, bag, after_view)
    # Join the counts of images that gave no view and of views that were refused.
    tally = bag.assembler.tally + stack.tally
    try:
        return replace(stack.volume(), views=tally)
    except ScanError as error:
        raise ScanError(no_count_line(str(error), tally, bag.hints)) from error
