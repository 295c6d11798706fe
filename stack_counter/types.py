# SPDX-License-Identifier: Apache-2.0
"""The nouns of the package as frozen dataclasses: SI units, optical camera frames, z-up world."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from typing_extensions import Self

BACKGROUND, CONTAINER, PARTS = 0, 1, 2  # the values of a label image
UNSEEN = 255  # pixels that a rectified label image has and the camera had not
# free: any open container with a level rim; hull: only an outline is known, no inner surface.
CONTAINER_KINDS = ("box", "round", "free", "none", "hull")


class Reason(str, Enum):
    """What qualifies a result: its slug, and one sentence for the person who reads it.

    Messages, files and JSON hold the slug. One that this release does not know (of a newer node)
    is kept under its own name. docs/reasons.md is made of this class.

    Attributes:
        sentence: what was seen, and what to do about it.
        degrades: the count is less than what was asked for, so its status is `degraded`.
    """

    sentence: str
    degrades: bool

    def __new__(cls, slug: str, sentence: str = "", degrades: bool = False) -> Reason:
        reason = str.__new__(cls, slug)
        reason._value_, reason.sentence, reason.degrades = slug, sentence, degrades
        return reason

    @classmethod
    def _missing_(cls, value: object) -> Reason | None:
        if not isinstance(value, str):
            return None
        unknown = str.__new__(cls, value)
        unknown._name_, unknown._value_, unknown.degrades = value.upper(), value, False
        unknown.sentence = f"This release does not know the reason {value}; update it."
        return unknown

    def __str__(self) -> str:
        return str(self.value)

    def __format__(self, spec: str) -> str:
        return format(str(self.value), spec)

    NO_DEPTH = (
        "no_depth", "No depth was measured on most of the stack, so V is the hull of its outlines "
        "and mostly too large; record aligned depth images.", True)
    DEPTH_FROM_PICTURES = (
        "depth_from_pictures", "Depth was computed from colour pictures, which measures V less "
        "exactly than a depth camera does; record aligned depth for a narrower interval.")
    ONE_SIDE = (
        "one_side", "All views look from nearly the same direction, so parts of the surface are "
        "hidden from all of them; move the camera around the stack for a narrower interval.")
    LOW_COVERAGE = (
        "low_coverage", "Much of the container's footprint was seen by no view, and V is a guess "
        "there; add views that look into the container.", True)
    NOTHING_FOUND = (
        "nothing_found", "Neither a container nor parts were found, so the count is 0; if there "
        "are some, check the region of interest, the camera poses and the labels.")
    CONTAINER_UNSURE = (
        "container_unsure", "Something like a rim was seen but no container could be fitted, so "
        "all was counted as a heap; show the whole rim, or configure or teach the container.",
        True)
    CUT_BY_IMAGE = (
        "cut_by_image", "The heap reaches the border of every image, so some of it may be "
        "missing; move the camera back or aim it at the heap.", True)
    VIEWS_LOST = (
        "views_lost", "Views that the collector had sent never reached the reconstructor, so V "
        "rests on fewer; check network and load of the machines, then scan again.", True)
    CAMERA_MISSING = (
        "camera_missing", "At least one camera of the rig gave this scan no view (see "
        "missing_cameras); check its cable, its driver and its topics.", True)
    BAG_TRUNCATED = (
        "bag_truncated", "The recording is cut short and was counted from what is left of it; "
        "record again, and end the recorder before the file is copied.", True)
    SINGLE_VIEW = (
        "single_view", "gamma was read from one depth image, without walls and floor of the "
        "container; record aligned depth in every view.")
    SHALLOW_STACK = (
        "shallow_stack", "The parts lie scattered rather than piled, which training hardly "
        "covers; the interval is wider, and a fuller container narrows it.")
    FEW_PARTS = (
        "few_parts", "There are fewer parts than in the training piles; the interval is wider, "
        "and counting by hand is quick.")
    LARGE_PART = (
        "large_part", "The container is only a few part sizes wide, less than in training; check "
        "the part's volume, or count such parts in a wider container.")
    UNLIKE_TRAINING = (
        "unlike_training", "The surface is unlike all that the network learnt from, as with a "
        "wrong part volume, ordered packing or foreign objects; check part and container.")
    PART_DISAGREES = (
        "part_disagrees", "The estimator contradicts what is known of this part, as with another "
        "part in the container, ordered packing or foreign objects; check the content.", True)
    FILL_UNLIKE_PILES = (
        "fill_unlike_piles", "The fill is lower or the container narrower than in all piles known "
        "of this part; count one such container and add it (stack-counter part calibrate).")
    PART_UNUSED = (
        "part_unused", "What is known of the part was not used, for want of depth or a container "
        "or because another part volume was given; record depth, or name the part alone.")
    CALIBRATED_ELSEWHERE = (
        "calibrated_elsewhere", "None of the part's counted scans is of this rig; count one "
        "container on it and add it (stack-counter part calibrate).")
    ESTIMATOR_UNHEARD = (
        "estimator_unheard", "The part's piles were read by another estimator, so this one was "
        "not asked; run stack-counter part add again with it.")


@dataclass(frozen=True)
class Intrinsics:
    """Camera calibration, as in `sensor_msgs/CameraInfo`.

    Attributes:
        width, height: image size, pixels.
        fx, fy, cx, cy: pinhole parameters, pixels; pixel centres lie on whole numbers.
        distortion_model: `plumb_bob`, `rational_polynomial`, `equidistant`, or "" for none.
        distortion: coefficients in OpenCV's order; empty or all zero for none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: str = ""
    distortion: tuple[float, ...] = ()

    @property
    def K(self) -> np.ndarray:
        """(3, 3) float64 camera matrix, pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)


@dataclass(frozen=True, eq=False)
class View:
    """One posed image.

    Attributes:
        stamp_ns: time of exposure, ns.
        intrinsics: calibration of all the images below.
        T_world_camera: (4, 4) float64, camera in its optical frame (x right, y down, z forward).
        color: (h, w, 3) uint8 RGB, or None.
        depth: (h, w) float32, metres along optical z, 0 where invalid, or None.
        labels: (h, w) uint8 label image (0 background, 1 container, 2 parts), or None.
        camera: name of the optical frame.
        fixed: the camera cannot move (its pose comes from static transforms alone).
    """

    stamp_ns: int
    intrinsics: Intrinsics
    T_world_camera: np.ndarray
    color: np.ndarray | None = None
    depth: np.ndarray | None = None
    labels: np.ndarray | None = None
    camera: str = ""
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class WallShape(ABC):
    """The outer face of a container's wall as a smooth function of a few parameters.

    Attributes:
        params: (m,) float64; the subclass says what each is.
    """

    params: np.ndarray

    @property
    @abstractmethod
    def kind(self) -> str:
        """One of `CONTAINER_KINDS`."""

    @property
    @abstractmethod
    def prior_std(self) -> np.ndarray:
        """(m,) standard deviations of the parameters around a first guess."""

    @property
    @abstractmethod
    def center(self) -> np.ndarray:
        """(2,) metres, the wall's middle in the world."""

    @property
    @abstractmethod
    def yaw(self) -> float:
        """Angle from the world's x to the wall's own, rad."""

    def with_params(self, params: np.ndarray) -> Self:
        """The same kind of shape with other parameters (m,)."""
        return replace(self, params=params)

    @abstractmethod
    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        """(n,) metres that (n, 2) world points lie inside the outer face, `below` ((n,) metres)
        the rim; negative outside."""

    @abstractmethod
    def outward_normals(self, xy: np.ndarray) -> np.ndarray:
        """(n, 2) horizontal unit normals of the wall nearest to (n, 2) world points."""

    @abstractmethod
    def ring(self, below: float, inwards: float) -> np.ndarray:
        """(k, 2) counter-clockwise outline, world, metres.

        Args:
            below: depth below the rim, metres.
            inwards: distance from the outer face, metres.
        """

    @abstractmethod
    def offset_inwards(self, inwards: float) -> WallShape:
        """The shape with its whole face moved inwards by so many metres."""

    @abstractmethod
    def in_own_frame(self) -> WallShape:
        """The shape in the container's own frame: its middle at 0, its yaw 0."""


@dataclass(frozen=True, eq=False)
class Container:
    """What holds the parts.

    Attributes:
        kind: one of `CONTAINER_KINDS`.
        T_world_container: (4, 4) float64; origin at the centre of the bottom, on the support
            plane; z up; x along the first inner side.
        inner_size_m: x and y of the rim opening, and height from inner floor to rim, metres;
            zeros for `none`.
        wall_thickness_m, floor_thickness_m: metres; the wall's is measured horizontally.
        rings: (k, n, 3) counter-clockwise outlines of the inner wall, container frame, metres,
            from the support plane (below the floor) to the rim; None for `none` and `hull`, and
            in a container that came by message.
        wall_shape: outer face of the wall, container frame; None as for `rings`.
    """

    kind: str
    T_world_container: np.ndarray
    inner_size_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wall_thickness_m: float = 0.0
    floor_thickness_m: float = 0.0
    rings: np.ndarray | None = None
    wall_shape: WallShape | None = None

    @property
    def outer_size_m(self) -> tuple[float, float, float]:
        """x and y at the rim, and from the support plane up to the rim, metres."""
        (x, y, depth), wall = self.inner_size_m, 2 * self.wall_thickness_m
        if not any(self.inner_size_m):
            return (0.0, 0.0, 0.0)
        return (x + wall, y + wall, depth + self.floor_thickness_m)


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights over a regular grid.

    Attributes:
        T_world_map: (4, 4) float64; cell (row, col) covers x in [col, col + 1) * pitch and
            y in [row, row + 1) * pitch of the map frame, z up, z = 0 on the support plane.
        pitch: side of a cell, metres.
        heights: (rows, cols) float32, metres along map z; NaN where not valid.
    """

    T_world_map: np.ndarray
    pitch: float
    heights: np.ndarray


@dataclass(frozen=True, eq=False)
class KeyView:
    """The view that shows the most parts, cropped to them (paper, section 3.2).

    Attributes:
        stamp_ns: of the view.
        intrinsics: of the crop (principal point shifted), no distortion.
        T_world_camera: (4, 4) float64.
        part_pixels: number of pixels labelled parts.
        labels: (h, w) uint8 label image of the crop.
        depth: (h, w) float32 metres of the crop, 0 where invalid; None without depth.
        color: (h, w, 3) uint8 RGB of the crop, or None.
    """

    stamp_ns: int
    intrinsics: Intrinsics
    T_world_camera: np.ndarray
    part_pixels: int
    labels: np.ndarray
    depth: np.ndarray | None = None
    color: np.ndarray | None = None


@dataclass(frozen=True)
class ViewTally:
    """How many views came, were used, and were skipped for which reason."""

    received: int = 0
    used: int = 0
    skipped: dict[str, int] = field(default_factory=dict)

    def __add__(self, later: ViewTally) -> ViewTally:
        """The tally of two stages in a row: what the first passed on, the second received."""
        return ViewTally(self.received, later.used,
                         dict(Counter(self.skipped) + Counter(later.skipped)))


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: vertices (n, 3) float32 metres, world; triangles (m, 3) int32; colours (n, 3)
    uint8 RGB or None."""

    vertices: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class StackVolume:
    """The stack as reconstructed from one scan.

    Attributes:
        stamp_ns: stamp of the last view used.
        stack_volume, stack_volume_std: V and its standard deviation, m3.
        container: fitted or configured.
        fill_level: min, mean and max of the filled share of the inner height; zeros if unknown.
        coverage: share of the interior's footprint that some view saw, 0 to 1.
        top: highest surface inside the rim opening; None where only a hull is known.
        inner: inner surface of the container (floor) on the same grid.
        key_view: None if no view showed parts.
        views: tally of the scan so far.
        reasons: what qualifies the result.
        seconds: time spent by stage, s.
        mesh: carved surface, world frame, for display.
        missing_cameras: names of the rig's cameras that gave no view.
        one_side: all views look from nearly the same direction, as those of one fixed camera.
    """

    stamp_ns: int
    stack_volume: float
    stack_volume_std: float
    container: Container
    fill_level: tuple[float, float, float]
    coverage: float
    top: HeightMap | None
    inner: HeightMap | None
    key_view: KeyView | None
    views: ViewTally
    reasons: tuple[Reason, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    mesh: Mesh | None = None
    missing_cameras: tuple[str, ...] = ()
    one_side: bool = False

    @property
    def overfilled(self) -> bool:
        """Parts stand above the rim."""
        return self.fill_level[2] > 1

    def without(self, cameras: Iterable[str]) -> StackVolume:
        """The volume of a scan to which these cameras gave nothing."""
        missing = tuple(cameras)
        reasons = self.reasons + ((Reason.CAMERA_MISSING,) if missing else ())
        return replace(self, missing_cameras=missing, reasons=reasons)


@dataclass(frozen=True, eq=False)
class OccupancyEstimate:
    """gamma with its relative error.

    Attributes:
        gamma: estimated occupancy ratio, 0 to 1.
        gamma_std: its standard deviation.
        scores: (n,) float64: on data whose families of parts the estimator had not seen, the log
            of true over estimated, in its relative standard deviations; the interval comes from
            their quantiles.
        estimator: name, e.g. `depth_corrected (baseline)`.
        reasons: what qualifies the estimate.
        shares: what gamma comes from and how much each weighed, together 1: `estimator`, `piles`
            of this part, `counted` scans of it, `training` piles of other parts.
        counted_scans: of this part on this rig that it rests on.
    """

    gamma: float
    gamma_std: float
    scores: np.ndarray
    estimator: str
    reasons: tuple[Reason, ...] = ()
    shares: dict[str, float] = field(default_factory=lambda: {"estimator": 1.0})
    counted_scans: int = 0


@dataclass(frozen=True, eq=False)
class StackCount:
    """The answer: how many parts, and how sure.

    Attributes:
        count: parts in the stack.
        count_interval: (low, high) with low <= count <= high.
        confidence: probability that the interval holds the true count.
        gamma, gamma_std: occupancy ratio and its standard deviation.
        unit_volume: volume of one part, m3.
        volume: what gamma was multiplied with.
        estimator: who said gamma.
        gamma_shares: how much it and what is known of the part weighed; see `OccupancyEstimate`.
        counted_scans: that gamma rests on.
        status: `ok`, or `degraded` where one of the reasons degrades.
        reasons: what qualifies the count.
        seconds: time spent by stage, s.
    """

    count: int
    count_interval: tuple[int, int]
    confidence: float
    gamma: float
    gamma_std: float
    unit_volume: float
    volume: StackVolume
    estimator: str
    status: str = "ok"
    reasons: tuple[Reason, ...] = ()
    gamma_shares: dict[str, float] = field(default_factory=lambda: {"estimator": 1.0})
    counted_scans: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
