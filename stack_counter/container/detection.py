"""The container of a scan: as configured, as found in the fused surface and the views, or none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.rim import Rim, find_rim
from stack_counter.container.wall_fit import Wall, face_points, fit_wall
from stack_counter.container.wall_shapes import BoxWall, RoundWall, WallShape
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.tsdf import FusedSurface
from stack_counter.types import CONTAINER, Container, HeightMap, View

_MIN_HEIGHT = 0.006  # of a rim, m
MIN_RIM = 0.75  # share of the outline on which a rim must be seen
_MIN_FACE = 0.8  # share of the outline on which one face of the wall must be seen
_SOME_RIM, _RIM_AND_FACE = 0.6, 1.6  # of a rectangle or circle: least, and sum of the two shares
# Sum of the shares from which a heap may be a container that was not found: of a rectangle or
# circle, and of a free-form outline.
_RIM_LIKE, _FREE_RIM_LIKE = 1.45, 1.7
# The same where all views come from one side, which shows no outer face.
_ONE_SIDE_RIM, _ONE_SIDE_FACE = 0.45, 0.4
_ONE_SIDE = 0.35  # rad, between the directions to all cameras
_MIN_DROP = 0.1  # share of the outline on which the surface must fall inside the rim
_MAX_SPREAD = 0.00045  # of the faces around their fit, without the depth's noise, m
_NOISE_SPREAD = 0.3  # and what each metre of that adds
_PITCH = 0.001  # of the map in which the rim is looked for, m
_MOST_CELLS = 400  # along a side of that map
_LEVELS = 17  # outlines of a wall, from the support plane to the rim
_RIM_ERROR = 0.001  # standard deviation of a wall's thickness measured on its rim, m
# One camera above loses depth on both edges of the rim: what its width lacks, m and per metre of
# the depth's noise, and how well that is known; as measured on training scenes.
_LOST_WIDTH, _LOST_BY_NOISE, _LOST_ERROR = 0.0012, 0.95, 0.4
_UNKNOWN_WALL = (0.004, 0.01)  # thickness that is assumed where nothing shows it, and its error


def find_container(view: FusedSurface, views: list[View], region: Region, voxel_size: float,
                   config: ReconstructorConfig) -> tuple[Container, bool]:
    """The container as configured, or as found; and whether that is sure.

    Args:
        view: the fused surface.
        views: that it was fused from.
        region: where to look; its `plane_z` is the support plane.
        voxel_size: metres.
        config: `container_*` settings; zeros are measured.

    Returns:
        A container of kind `box`, `round`, `free` or `none`, the floor's thickness being the
        configured one, else the wall's; and False if it is `none` though something rim-like
        stands around the stack.

    Raises:
        ScanError: a kind is configured and no such rim is found.
    """
    if config.container_kind == "none":
        return no_container(region), True
    if config.container_pose == "given":
        return _configured(config, region), True
    rim = find_rim(rim_map(view, region, voxel_size), region.lowest, config.container_kind)
    wall = None if rim is None else _wall(rim, views, region, config)
    named = any(np.any(v.labels == CONTAINER) for v in views if v.labels is not None)
    if rim is not None and wall is not None and (
            _is_container(rim, wall, region, named)
            or seen_from_one_side(views, region) and _is_container_from_above(rim, wall)):
        return _container(wall.form, wall.thickness, rim.height, region, config), True
    if config.container_kind != "auto":
        seen = 0.0 if rim is None else rim.outline_share
        raise ScanError(f"no {config.container_kind} container found: a level rim on {seen:.0%} "
                        f"of its outline, a wall below it on "
                        f"{0.0 if wall is None else max(wall.outer_share, wall.inner_share):.0%}; "
                        f"expected {MIN_RIM:.0%} and {_MIN_FACE:.0%}")
    return no_container(region), not (rim is not None and wall is not None and _is_rim_like(
        rim, wall))


def no_container(region: Region) -> Container:
    """A heap: the frame stands on the support plane in the middle of the region."""
    centre = (region.low + region.high) / 2
    return Container("none", geometry.pose(np.eye(3), np.append(centre[:2], region.plane_z)))


def rim_map(view: FusedSurface, region: Region, voxel_size: float) -> HeightMap:
    """Map of the region in which a rim is looked for."""
    size = (region.high - region.low)[:2]
    pitch = max(_PITCH, float(size.max()) / _MOST_CELLS, voxel_size / 2)
    rows, cols = (int(n) for n in np.ceil(size[::-1] / pitch))
    T_world_map = geometry.pose(np.eye(3), np.append(region.low[:2], region.plane_z))
    return view.heights(T_world_map, pitch, (rows, cols))


def _wall(rim: Rim, views: list[View], region: Region, config: ReconstructorConfig
          ) -> Wall | None:
    if rim.height < _MIN_HEIGHT:
        return None
    if config.container_wall_m > 0:
        known = (config.container_wall_m, 1e-6)
    elif np.isfinite(rim.width) and seen_from_one_side(views, region):
        lost = _LOST_WIDTH + _LOST_BY_NOISE * region.noise
        known = (rim.width + lost, _LOST_ERROR * lost)
    elif np.isfinite(rim.width):
        known = (rim.width, _RIM_ERROR)
    else:
        known = _guessed_wall(rim, views, region)
    points = face_points(views, region, rim.form, rim.height)
    return fit_wall(rim.form, points, rim.height, *known, noise=region.noise)


def _guessed_wall(rim: Rim, views: list[View], region: Region) -> tuple[float, float]:
    """Thickness and its standard deviation, metres, where parts hide the rim's inner edge."""
    from stack_counter.container.wall_network import (
        estimate_wall,
    )  # brings in torch, which takes seconds

    return estimate_wall(views, rim.form, rim.height, region.plane_z) or _UNKNOWN_WALL


def _is_container(rim: Rim, wall: Wall, region: Region, named: bool) -> bool:
    """A heap has no level rim, and nothing smooth and steep all around below it, unless labels
    name a container; a block has nothing inside."""
    smooth = wall.spread < _MAX_SPREAD + _NOISE_SPREAD * region.noise
    steep = max(wall.outer_share, wall.inner_share) >= _MIN_FACE
    falls = rim.inner_drop_share >= _MIN_DROP or wall.inner_share >= _MIN_FACE
    if rim.form.kind == "free":  # such an outline bends to many a heap
        return rim.outline_share >= MIN_RIM and (named or steep and smooth) and falls
    # A rectangle or a circle fits to no heap: much of a rim makes up for little of a wall.
    face = max(wall.outer_share, wall.inner_share)
    return (rim.outline_share >= MIN_RIM and (named or steep) and falls
            or rim.outline_share >= _SOME_RIM and rim.outline_share + face >= _RIM_AND_FACE
            and (falls or wall.inner_share >= _SOME_RIM))


def _is_container_from_above(rim: Rim, wall: Wall) -> bool:
    """What one camera above sees of a container is its rim and some of the wall's inner face."""
    return rim.form.kind != "free" and rim.outline_share >= _ONE_SIDE_RIM \
        and wall.inner_share >= _ONE_SIDE_FACE


def seen_from_one_side(views: list[View], region: Region) -> bool:
    """Whether the directions from the region's middle to all cameras are nearly the same."""
    away = np.array([v.T_world_camera[:3, 3] for v in views]) - (region.low + region.high) / 2
    away /= np.linalg.norm(away, axis=1)[:, None]
    return bool(np.arccos(np.clip(away @ away[0], -1, 1)).max() < _ONE_SIDE)


def _is_rim_like(rim: Rim, wall: Wall) -> bool:
    """Not enough to be a container, too much to be none."""
    face = max(wall.outer_share, wall.inner_share)
    least = _FREE_RIM_LIKE if rim.form.kind == "free" else _RIM_LIKE
    return min(rim.outline_share, face) >= 0.5 and rim.outline_share + face >= least


def _container(form: WallShape, wall: float, height: float, region: Region,
               config: ReconstructorConfig) -> Container:
    """Container of a fitted wall; configured sizes replace the fitted ones."""
    size = config.container_inner_size_m
    if size[0] and isinstance(form, BoxWall):
        form = _resized(form, np.array(size[:2]) + 2 * wall)
    if size[0] and isinstance(form, RoundWall):
        form = RoundWall(np.array([*form.params[:2], size[0] / 2 + wall, *form.params[3:]]))
    floor = config.container_floor_m or wall
    if size[2]:
        floor = config.container_floor_m or max(height - size[2], 0.0)
        height = floor + size[2]
    return from_wall(form, wall, height, floor, region.plane_z)


def _resized(form: BoxWall, size: np.ndarray) -> BoxWall:
    """With sides of `size`, the longer one where the longer one was found."""
    x, y, yaw, a, b, draft = form.params
    if (size[0] > size[1]) != (a > b):
        yaw += np.pi / 2
    return BoxWall(np.array([x, y, yaw, *size, draft]))


def _configured(config: ReconstructorConfig, region: Region) -> Container:
    size = config.container_inner_size_m
    if not all(size) or config.container_kind == "free":
        raise ScanError(f"container_kind is {config.container_kind} and container_inner_size_m "
                        f"{size}; a container whose pose is given needs three sizes above 0 and "
                        "the kind box or round")
    (x, y, yaw), wall = config.container_xyyaw, config.container_wall_m
    form: WallShape = BoxWall(np.array([x, y, yaw, size[0] + 2 * wall, size[1] + 2 * wall, 0.0]))
    if config.container_kind == "round":
        form = RoundWall(np.array([x, y, size[0] / 2 + wall, 0.0, 0.0]))
    floor = config.container_floor_m or wall
    return from_wall(form, wall, floor + size[2], floor, region.plane_z)


def from_wall(form: WallShape, wall: float, height: float, floor: float, plane_z: float
              ) -> Container:
    """Container of a wall.

    Args:
        form: outer face, world frame.
        wall, floor: thickness, metres.
        height: of the rim above the support plane, metres.
        plane_z: world height of the support plane, metres.
    """
    (x, y), yaw = form.pose
    c, s = np.cos(yaw), np.sin(yaw)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([x, y, plane_z]))
    levels = np.linspace(0, height, _LEVELS)
    rings = np.stack([np.pad((form.ring(height - z, wall) - [x, y]) @ T[:2, :2], ((0, 0), (0, 1)),
                             constant_values=z) for z in levels])
    width, length = np.ptp(rings[-1, :, :2], axis=0)
    return Container(form.kind, T, (float(width), float(length), height - floor), wall, floor,
                     rings, form.centred())


def with_floor(container: Container, floor: float) -> Container:
    """The container with another floor thickness, metres, below the same rim."""
    width, length, depth = container.inner_size_m
    rim = container.floor_thickness_m + depth
    return replace(container, floor_thickness_m=floor, inner_size_m=(width, length, rim - floor))
