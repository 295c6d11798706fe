"""The whole method on one page: views in, V and a count out. Nodes and `--direct` both drive it.

Source: paper, section 3: count = gamma * V / v.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import configured_container
from stack_counter.container.detection import find_container, seen_from_one_side
from stack_counter.container.placement import place_container
from stack_counter.counting import make_count
from stack_counter.display.mesh_colors import color_mesh
from stack_counter.errors import ScanError, ViewError
from stack_counter.fusion.leveling import level_to_support
from stack_counter.fusion.region import Region, crop_to_region, find_region, grow
from stack_counter.fusion.tsdf import FusedSurface, Tsdf
from stack_counter.fusion.voxel_size import COARSEST, automatic_voxel_size
from stack_counter.multiview import visual_hull
from stack_counter.multiview.scan import StereoScan, depth_scan
from stack_counter.occupancy.baselines import OccupancyEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.informed_gamma import estimate_occupancy
from stack_counter.reconstruction.plausibility import (
    check_agreement,
    second_container,
    stack_leaves_every_image,
)
from stack_counter.reconstruction.stack_volume import MeasuredStack, measure_stack
from stack_counter.segmentation import Segmenter
from stack_counter.segmentation.from_container import Geometric
from stack_counter.segmentation.labels import GivenLabels, require_labels
from stack_counter.segmentation.scan_labels import ScanLabels
from stack_counter.types import (
    BACKGROUND,
    PARTS,
    Container,
    KeyView,
    Mesh,
    StackCount,
    StackVolume,
    View,
    ViewTally,
)

_FIRST_VIEWS = 3  # the region of interest is found from this many
_MIN_SEEN = 1  # views that must have seen a surface
_LOW_COVERAGE = 0.7
_LIVE_VIEWS = 24  # that the continuous mode remembers, of a fixed camera the first number here:
_LIVE_FIXED = 2
_CHANGED = 3.0  # standard deviations beyond which a view shows that something has changed
_KEY_STRIDE = 4  # pixels between those counted to choose the key view


class StackCounter:
    """Collects the views of one scan; says V, and with an estimator and a part the count."""

    def __init__(self, config: ReconstructorConfig):
        """Raises `ConfigError` where the taught container that `config` names is not known, and
        ConfigError, PromptError or WeightsError as `ScanLabels`."""
        self._config = config
        self._taught = configured_container(config)
        self._labels = ScanLabels(config)
        self._min_views = 1 if config.live else config.min_views
        self.reset()

    def reset(self, unit_volume: float = 0.0) -> None:
        """Forgets the scan; the next one is of parts of `unit_volume` (m3; 0: not known)."""
        self._unit_volume = unit_volume
        self._labels.reset()
        self._segmenter: Segmenter = GivenLabels()  # of the last volume
        self._tsdf: Tsdf | None = None  # once it is known where the stack is
        self._surface: FusedSurface | None = None  # of the last volume
        self._region: Region | None = None
        self._rivals: str | None = None  # containers, where more than one is in sight
        self._views: list[View] = []  # used so far; once the region is known, cropped to it
        self._received = self._used = 0
        self._skipped: Counter[str] = Counter()
        self._seconds: dict[str, float] = defaultdict(float)
        self.coverage = 0.0  # of the footprint, as of the last volume

    @property
    def tally(self) -> ViewTally:
        """Views received, used and skipped by reason."""
        return ViewTally(self._received, self._used, dict(self._skipped))

    @property
    def region(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Low and high corner (3,), world, metres, of the box in which the stack is looked for: as
        found, before that as configured; None where it is neither."""
        if self._region is not None:
            return self._region.low, self._region.high
        center, size = np.array(self._config.roi_center_m), np.array(self._config.roi_size_m)
        return (center - size / 2, center + size / 2) if size.any() else None

    @property
    def views(self) -> list[View]:
        """The views kept so far; once the region is found, cut to it."""
        return list(self._views)

    def add_view(self, view: View) -> None:
        """Fuses one view, or keeps it until the first few say where the stack is.

        Raises:
            ViewError: the view is refused (and counted under its reason); the scan goes on.
        """
        try:
            with self._timed("integrate"):
                self._add(self._checked(view))
        except ViewError as error:
            self.skip(error)
            raise
        self._received += 1

    def skip(self, error: ViewError) -> None:
        """Counts a view that was refused."""
        self._received += 1
        self._skipped[error.reason] += 1

    def volume(self) -> StackVolume:
        """V of what the views so far have shown.

        Raises:
            ScanError: too few views, or nothing left after carving.
        """
        if len(self._views) < self._min_views:
            raise ScanError(f"{len(self._views)} views used of {self._received} (skipped: "
                            f"{dict(self._skipped)}); expected at least {self._min_views}")
        with self._timed("finish"):
            with self._timed("segment"):
                self._views = self._labels.label(self._views)
            volume = self._from_depth() if self._with_depth() else self._from_labels()
        self.coverage = volume.coverage
        return replace(volume, seconds=dict(self._seconds))

    def labelled_views(self) -> list[View]:
        """The views of the last volume, cut to what matters, with their label images."""
        return [replace(view, labels=self._segmenter.segment(view)) for view in self._views]

    def count(self, part: Part, estimator: OccupancyEstimator, confidence: float) -> StackCount:
        """The number of parts.

        Raises:
            ScanError, PartError: as `volume` and `count_stack`.
        """
        return count_stack(self.volume(), part, estimator, confidence)

    def _checked(self, view: View) -> View:
        if not self._config.live and len(self._views) >= self._config.max_views:
            raise ViewError("too_many_views", f"{len(self._views)} views already; expected at "
                                              f"most {self._config.max_views}")
        view = geometry.rectify(view)
        self._labels.take(view)
        if self._views and (view.depth is not None) != self._with_depth():
            raise ViewError("no_depth" if self._with_depth() else "unexpected_depth",
                            "some views of the scan have depth and some have not; expected alike")
        if view.depth is None:
            return view
        low, high = self._config.depth_min, self._config.depth_trunc
        valid = (view.depth >= low) & (view.depth <= high)
        if not valid.any():
            raise ViewError("empty_depth", f"no depth between {low} and {high} m; expected some")
        return replace(view, depth=np.where(valid, view.depth, 0).astype(np.float32))

    def _with_depth(self) -> bool:
        return bool(self._views) and self._views[0].depth is not None

    def _add(self, view: View) -> None:
        if view.depth is not None and self._region is not None:
            self._region = grow(self._region, view)
            view = self._fuse(view)
        self._views.append(view)
        self._used += 1
        if self._config.live:
            self._forget_views(view)
        if view.depth is not None and self._region is None \
                and len(self._views) >= min(_FIRST_VIEWS, self._min_views):
            self._find_region()

    def _forget_views(self, newest: View) -> None:
        """The continuous mode never ends: old views, which show what is no longer there, go."""
        same = [v for v in self._views if v.fixed and v.camera == newest.camera]
        if newest.fixed:
            self._views = [v for v in self._views if not any(v is old for old in
                                                             same[:-_LIVE_FIXED])]
        del self._views[:-_LIVE_VIEWS]

    def _find_region(self) -> None:
        try:
            self._region = find_region(self._views, self._config)
        except ScanError:
            return  # nothing in sight yet: later views may show it
        c, first, self._views = self._config, self._views, []
        size = c.voxel_size or automatic_voxel_size(self._region, self._unit_volume)
        self._tsdf = Tsdf(size, c.trunc_voxels, c.depth_trunc, c.max_weight, c.max_memory_mb)
        if not any(self._config.roi_size_m):
            self._rivals = second_container(first, self._region)
        for view in first:
            try:
                self._views.append(self._fuse(view))
            except ViewError as error:
                self._skipped[error.reason] += 1
                self._used -= 1

    def _fuse(self, view: View) -> View:
        assert self._region is not None and self._tsdf is not None  # for the type checker
        view = level_to_support(crop_to_region(view, self._region), self._region)
        assert view.depth is not None  # for the type checker
        depth = smoothed(view.depth, self._region.noise)
        view = replace(view, depth=depth)
        surface = self._region.contains(geometry.world_points(view))
        seen = self._with_background(view)
        if self._config.live and self._surface is not None:
            self._tsdf.forget(self._changed(view, self._surface), seen, view.intrinsics,
                              view.T_world_camera)
        self._tsdf.integrate(seen, surface, view.intrinsics, view.T_world_camera)
        return view

    def _changed(self, view: View, surface: FusedSurface) -> np.ndarray:
        """(h, w) bool: pixels whose depth is not that of the last volume, noise apart."""
        assert view.depth is not None and self._region is not None  # for the type checker
        expected = surface.depth(view.intrinsics, view.T_world_camera)
        off = np.abs(view.depth - expected) > _CHANGED * self._region.noise
        changed = off & (view.depth > 0) & (expected > 0)
        # A lone pixel beside an edge has not changed: its ray ends now on one side, now beyond.
        return cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_OPEN,
                                np.ones((3, 3), np.uint8)) > 0

    def _with_background(self, view: View) -> np.ndarray:
        """Depth in which pixels labelled background are far away where there is none: a ray that
        ends in the background proves its whole length empty."""
        assert view.depth is not None  # for the type checker
        if view.labels is None:
            return view.depth
        far = (view.labels == BACKGROUND) & (view.depth == 0)
        return np.where(far, np.float32(0.99 * self._config.depth_trunc), view.depth)

    def _from_depth(self) -> StackVolume:
        if self._region is None:
            self._region = find_region(self._views, self._config)  # says what is missing
            self._find_region()
        assert self._region is not None and self._tsdf is not None  # for the type checker
        region, pitch = self._region, self._tsdf.voxel_size
        if not self._config.live:  # there, what views show changes
            check_agreement(self._views, region.noise)
        if self._rivals:
            raise ScanError(f"two containers: {self._rivals}; expected one, or a region of "
                            "interest (roi_center_m, roi_size_m) around one")
        mesh = self._tsdf.extract_triangle_mesh(_MIN_SEEN)
        if not len(mesh.triangles):
            raise ScanError(f"no surface left after carving {len(self._views)} views; expected "
                            "some: depth and poses disagree")
        top = self._surface = FusedSurface(mesh)
        seen = (top, self._views, region, pitch, self._config)
        container, sure = find_container(*seen) if self._taught is None \
            else (place_container(self._taught, *seen), True)
        floor_known = self._taught is not None or self._config.container_floor_m > 0
        one_side = seen_from_one_side(self._views, region)
        result = measure_stack(top, container, region, pitch, floor_known, one_side)
        reasons = ["one_side"] if one_side else []
        if result.coverage < _LOW_COVERAGE:
            reasons.append("low_coverage")
        if container.kind == "none" and result.stack_volume == 0:
            reasons.append("nothing_found")
        if not sure:
            reasons.append("container_unsure")
        if container.kind == "none" and stack_leaves_every_image(self._views, region):
            reasons.append("cut_by_image")
        return self._volume(result, Geometric(result.container, region),
                            color_mesh(mesh, self._views), *reasons)

    def _from_labels(self) -> StackVolume:
        if not any(np.any(require_labels(view) == PARTS) for view in self._views):
            return replace(self._from_hull(), stack_volume=0.0, stack_volume_std=0.0,
                           reasons=("nothing_found",))
        if not self._config.live and all(view.color is not None for view in self._views):
            with suppress(ScanError):  # then the hull stands
                scan = depth_scan(self._views, self._config)
                return replace(volume_of(scan, self._config, self._unit_volume),
                               views=self.tally)
        return self._from_hull()

    def _from_hull(self) -> StackVolume:
        c = self._config
        carved = visual_hull.carve_visual_hull(
            self._views, c.voxel_size or COARSEST, c.hull_min_share, votes=2 if c.live else 1
        )
        container = Container("hull", geometry.pose(np.eye(3), carved.middle))
        # An outline's error of one pixel moves the surface by about half a voxel.
        skin = len(carved.surface) * carved.voxel_size**3
        mesh = Mesh(carved.surface.astype(np.float32), np.zeros((0, 3), np.int32))
        result = MeasuredStack(
            carved.volume, skin / 2, None, None, 1.0, (0.0, 0.0, 0.0), container
        )
        return self._volume(result, GivenLabels(), mesh, "no_depth")

    def _volume(self, measure: MeasuredStack, segmenter: Segmenter, mesh: Mesh, *reasons: str
                ) -> StackVolume:
        self._segmenter = GivenLabels() if self._labels.on_views else segmenter
        with self._timed("segment"):
            key_view = find_key_view(self._views, self._segmenter)
        return StackVolume(
            stamp_ns=max(v.stamp_ns for v in self._views), stack_volume=measure.stack_volume,
            stack_volume_std=measure.stack_volume_std, container=measure.container,
            fill_level=measure.fill_level, coverage=measure.coverage, top=measure.top,
            inner=measure.inner, key_view=key_view, views=self.tally, reasons=reasons, mesh=mesh)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[stage] += time.perf_counter() - start


def volume_of(scan: StereoScan, config: ReconstructorConfig, unit_volume: float = 0.0
              ) -> StackVolume:
    """V of pictures with depth by stereo, as from a depth camera, unless the container is closed.

    `unit_volume` in m3, 0 where not known.

    Raises:
        ScanError: as `StackCounter.volume`.
    """
    stack = StackCounter(replace(config, segmenter="auto", prompts=""))  # they are labelled
    stack.reset(unit_volume)
    for view in scan.views:
        with suppress(ViewError):  # counted in the tally; the others go on
            stack.add_view(view)
    volume = stack.volume()
    if scan.is_closed(volume, config):
        volume = scan.carved(volume, config.voxel_size or COARSEST)
    return scan.in_world(replace(volume, key_view=find_key_view(scan.views, GivenLabels())))


def smoothed(depth: np.ndarray, noise: float) -> np.ndarray:
    """(h, w) float32 depth with noise averaged inside surfaces and not across their edges.

    Args:
        depth: metres, 0 invalid; stays so.
        noise: standard deviation, metres, that steps are told from.
    """
    if noise <= 0:
        return depth
    out = cv2.bilateralFilter(depth, 5, 3 * noise, 1.5)
    return np.where(depth > 0, out, 0).astype(np.float32)


def joined_tally(collected: ViewTally, used: ViewTally) -> ViewTally:
    """One tally of a scan from the collector's and the reconstruction's, which follows it."""
    return ViewTally(collected.received, used.used,
                     dict(Counter(collected.skipped) + Counter(used.skipped)))


def find_key_view(views: list[View], segmenter: Segmenter) -> KeyView | None:
    """The view with the most part pixels, cropped to them (paper, section 3.2)."""
    shown = [np.count_nonzero(segmenter.segment(v, _KEY_STRIDE) == PARTS) for v in views]
    best = views[int(np.argmax(shown))]
    labels = segmenter.segment(best)
    rows, cols = np.nonzero(labels == PARTS)
    if not len(rows):
        return None
    cut = geometry.crop(replace(best, labels=labels), np.array([cols.min(), rows.min()]),
                        np.array([cols.max(), rows.max()]))
    return KeyView(
        best.stamp_ns,
        cut.intrinsics,
        cut.T_world_camera,
        len(rows),
        require_labels(cut),
        cut.depth,
        cut.color,
    )


def count_stack(volume: StackVolume, part: Part, estimator: OccupancyEstimator,
                confidence: float) -> StackCount:
    """gamma from the estimator and what is known of the part, then the count.

    Raises:
        ScanError, PartError: as `estimate_part`.
    """
    start = time.perf_counter()
    estimate = estimate_occupancy(volume, part, estimator)
    result = make_count(volume, part.unit_volume, estimate, confidence)
    return replace(result, seconds={**volume.seconds, "gamma": time.perf_counter() - start})
