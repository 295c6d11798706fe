# SPDX-License-Identifier: Apache-2.0
"""The method on one page: posed views in, V and a count out.

Nodes and `replay --direct` drive the same `StackCounter`.

Source: paper, section 3: count = gamma * V / v.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import configured_container
from stack_counter.errors import ConfigError, ScanError, ViewError
from stack_counter.multiview.monocular import load_nearness
from stack_counter.occupancy import OccupancyEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.reconstruction import DepthReconstruction, PictureReconstruction
from stack_counter.reconstruction.stage_timer import StageTimer
from stack_counter.segmentation.scan_labels import ScanLabels
from stack_counter.stack_count import count_stack
from stack_counter.types import StackCount, StackVolume, View, ViewTally


class StackCounter:
    """Counts one scan at a time: `start`, `add_view` for every view, then `volume` or `count`.

    Attributes:
        coverage: share of the footprint that the views had seen when `volume` was last asked.
    """

    def __init__(self, config: ReconstructorConfig, unit_volume: float = 0.0):
        """Reads what the settings name, and starts a first scan.

        Args:
            config: settings of the reconstruction.
            unit_volume: as for `start`.

        Raises:
            ConfigError: settings do not fit each other, name a container that is not taught, or
                name regions, of which each needs a counter of its own (`RegionCounters`).
            PromptError: the prompts are missing or malformed.
            WeightsError: the weights of SAM 2 or Depth Anything are missing or damaged.
        """
        if config.regions:
            raise ConfigError(f"regions names {[region.name for region in config.regions]}; "
                              "expected none to measure one stack: set roi_center_m and "
                              "roi_size_m to its region")
        self._config = config
        self._taught_container = configured_container(config)
        self._labels = ScanLabels(config)  # decides which pixel shows parts
        if config.depth_weights:
            load_nearness(Path(config.depth_weights))  # or a first scan would find them missing
        self.start(unit_volume)

    def start(self, unit_volume: float = 0.0) -> None:
        """Forgets the last scan. `unit_volume`, m3, helps to choose voxels; 0 if not known."""
        self._unit_volume = unit_volume
        self._labels.start()
        self._scan: DepthReconstruction | PictureReconstruction | None = None
        self._received, self._skipped = 0, Counter[str]()
        self._last_errors: dict[str, str] = {}
        self._stages = StageTimer()
        self.coverage = 0.0

    def add_view(self, view: View) -> None:
        """Takes one view into the scan.

        Raises:
            ViewError: the view is refused and counted under its reason; the scan goes on.
        """
        try:
            with self._stages("integrate"):
                if not self._config.live and len(self.views) >= self._config.max_views:
                    raise ViewError("too_many_views", f"{len(self.views)} views already; expected "
                                                      f"at most {self._config.max_views}")
                view = geometry.rectify(view)  # 1. A pinhole camera.
                self._labels.check_view(view)  # 2. It has what the segmenter works on.
                scan = self._scan or self._begin_scan(view)
                scan.add_view(view)  # 3. Fused and carved (depth), or kept (pictures).
                self._scan = scan
        except ViewError as error:
            self.skip_view(error)
            raise
        self._received += 1

    def skip_view(self, error: ViewError) -> None:
        """Counts a view that was refused."""
        self._received += 1
        self._skipped[error.reason] += 1
        self._last_errors[error.reason] = str(error)

    def volume(self) -> StackVolume:
        """Measures V of what the views so far have shown.

        Raises:
            ScanError: too few views, or nothing left after carving.
        """
        needed = 1 if self._config.live else self._config.min_views
        if self._scan is None or len(self.views) < needed:
            why = [self._last_errors[reason] for reason, _ in self._skipped.most_common(1)]
            raise ScanError("; ".join([f"{len(self.views)} views used of {self._received} (skipped"
                                       f": {dict(self._skipped)}); expected at least {needed}",
                                       *why]))
        with self._stages("finish"):
            with self._stages("segment"):
                self._scan.label_views(self._labels)  # 4. Label images from prompts, if any.
            volume = self._scan.measure_volume(self._taught_container)  # 5. The container, then V.
            with self._stages("segment"):
                key_view = self._scan.key_view()  # 6. What the network may read.
        self.coverage = volume.coverage
        # An error of the poses' scale is one of all three sides of V.
        scale_std = 3 * self._config.scale_std * volume.stack_volume
        return replace(volume, stack_volume_std=math.hypot(volume.stack_volume_std, scale_std),
                       key_view=key_view, views=self.tally, seconds=self._stages.seconds)

    def count(self, part: Part, estimator: OccupancyEstimator, confidence: float) -> StackCount:
        """Counts the parts that the views so far have shown.

        Raises:
            ScanError: too few views, nothing left after carving, or nothing to read gamma from.
            PartError: the part's volume is no positive number.
        """
        return count_stack(self.volume(), part, estimator, confidence)  # 7, 8. gamma * V / v.

    @property
    def tally(self) -> ViewTally:
        """Number of views received, used, and skipped by reason."""
        late = self._scan.refused_late if self._scan else ()
        skipped = self._skipped + Counter(error.reason for error in late)
        return ViewTally(self._received, self._received - skipped.total(), dict(skipped))

    @property
    def views(self) -> list[View]:
        """The views kept so far; with depth, cropped to the region once that is found."""
        return list(self._scan.views) if self._scan else []

    @property
    def region(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Low and high corner (3,), world, metres, of the box in which the stack is looked for.

        The box is the one found, before that the configured one; None where there is neither.
        """
        if self._scan is not None and self._scan.region is not None:
            return self._scan.region.low, self._scan.region.high
        center, size = np.array(self._config.roi_center_m), np.array(self._config.roi_size_m)
        return (center - size / 2, center + size / 2) if size.any() else None

    def labelled_views(self) -> list[View]:
        """Returns the views of the last volume with their label images."""
        if self._scan is None:
            return []
        segmenter, views = self._scan.segmenter, self._scan.measured_views
        return [replace(view, labels=segmenter.segment(view)) for view in views]

    def _begin_scan(self, first: View) -> DepthReconstruction | PictureReconstruction:
        """Depth is fused; pictures and labels are carved, by stereo depth where they allow it."""
        kind = PictureReconstruction if first.depth is None else DepthReconstruction
        return kind(self._config, self._unit_volume)
