# SPDX-License-Identifier: Apache-2.0
"""One scan, several stacks: a `StackCounter` for each named region, all fed with the same views.

Nodes and `replay --direct` drive this class; without named regions it is one `StackCounter`.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, ViewError, defect_line
from stack_counter.pipeline import StackCounter
from stack_counter.types import StackVolume, View, ViewTally


@dataclass(frozen=True, eq=False)
class RegionVolume:
    """V of one region, or why there is none.

    Attributes:
        region: its name; empty where no regions are named.
        volume: None where the region gives none.
        tally: what became of the views, as far as this region has used them.
        error: one line that says why there is no volume; empty if there is one.
    """

    region: str
    volume: StackVolume | None
    tally: ViewTally
    error: str = ""

    def with_missing_cameras(self, cameras: Iterable[str]) -> RegionVolume:
        """The same of a scan to which these cameras gave nothing."""
        return replace(self, volume=self.volume and self.volume.with_missing_cameras(cameras))


class RegionCounters:
    """Counts one scan at a time in every region: `start`, `add_view` for every view, `volumes`.

    Attributes:
        counters: one for each region, by its name; one named "" where no regions are named.
    """

    def __init__(self, config: ReconstructorConfig, unit_volume: float = 0.0):
        """Makes the counters, and starts a first scan; arguments and errors as `StackCounter`'s.

        Raises:
            ConfigError: settings do not fit each other, or name a container that is not taught.
            PromptError: the prompts are missing or malformed.
            WeightsError: the SAM 2 weights are missing or damaged.
        """
        settings = {region.name: config.of_region(region) for region in config.regions}
        self.counters = {name: StackCounter(own, unit_volume)
                         for name, own in (settings or {"": config}).items()}

    def start(self, unit_volume: float = 0.0) -> None:
        """Forgets the last scan. `unit_volume`, m3, helps to choose voxels; 0 if not known."""
        for counter in self.counters.values():
            counter.start(unit_volume)

    def add_view(self, view: View) -> None:
        """Takes one view into every region that it shows.

        Raises:
            ViewError: every region refuses the view, or regions are named and it has no depth:
                outlines alone do not say which region they belong to. The scan goes on.
        """
        if view.depth is None and "" not in self.counters:
            error = ViewError("no_depth", "no depth image; expected one to tell regions apart")
            self.skip_view(error)
            raise error
        errors = []
        for counter in self.counters.values():
            try:
                counter.add_view(view)
            except ViewError as error:
                errors.append(error)
        if len(errors) == len(self.counters):
            raise errors[0]

    def skip_view(self, error: ViewError) -> None:
        """Counts a view that was refused."""
        for counter in self.counters.values():
            counter.skip_view(error)

    def volumes(self, on_defect: Callable[[str], object] | None = None) -> Iterator[RegionVolume]:
        """Measures V of one region after the other; where one gives none, the others go on.

        Args:
            on_defect: takes the traceback of an exception that nobody expected, for a node that
                goes on: the region then gives no volume. None: it is raised.
        """
        for name, counter in self.counters.items():
            try:
                volume = replace(counter.volume(), region=name)
                yield RegionVolume(name, volume, volume.views)
            except ScanError as error:
                yield RegionVolume(name, None, counter.tally, str(error))
            except Exception as error:
                if on_defect is None:
                    raise
                on_defect(traceback.format_exc())
                yield RegionVolume(name, None, counter.tally, defect_line("measured", error))

    @property
    def tally(self) -> ViewTally:
        """Number of views received, used, and skipped by reason, in the region that used most."""
        return max((counter.tally for counter in self.counters.values()),
                   key=lambda tally: tally.used)

    @property
    def coverage(self) -> float:
        """Lowest coverage of all regions when their volumes were last asked."""
        return min(counter.coverage for counter in self.counters.values())

    @property
    def views(self) -> list[View]:
        """The views kept so far, for each region those that it has used."""
        return [view for counter in self.counters.values() for view in counter.views]

    @property
    def regions(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Low and high corner (3,), world, metres, of each box in which a stack is looked for."""
        return [counter.region for counter in self.counters.values() if counter.region is not None]
