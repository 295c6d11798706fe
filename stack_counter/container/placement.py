# SPDX-License-Identifier: Apache-2.0
"""Finds a taught container in a scan: only its pose is unknown."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from typing_extensions import override

from stack_counter.config import ReconstructorConfig
from stack_counter.container.base import SETTINGS as BASE_SETTINGS
from stack_counter.container.base import find_lower_edge
from stack_counter.container.catalogue import TaughtContainer
from stack_counter.container.construction import make_container, worn_rim_height
from stack_counter.container.detection import SETTINGS as DETECTION_SETTINGS
from stack_counter.container.detection import check_reach, rim_map
from stack_counter.container.inner_map import grown_downwards, sample_heights, with_inner_map
from stack_counter.container.openings import (
    find_openings,
    isolate_opening,
    several_containers,
)
from stack_counter.container.rim import (
    find_rim_points,
    measure_outline_share,
    measure_rim_height,
    rim_point_std,
)
from stack_counter.container.wall_fit import (
    FacePoints,
    Thickness,
    find_face_points,
    fit_outline,
    fit_wall,
)
from stack_counter.container.wall_shapes import SETTINGS as SHAPE_SETTINGS
from stack_counter.container.wall_shapes import rotation_2d
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.types import Container, HeightMap, View, WallShape


@dataclass(frozen=True)
class PlacementSettings:
    """How the pose of a known wall is searched; all values are chosen.

    Attributes:
        yaws: number of yaws that are tried against the rim.
        max_candidates: largest number of these, each better than its neighbours, that are fitted.
        similar_share: share of the rim by which a fit may be worse than the best and stay.
        max_distance: distance from a face, m, at which all points count alike: they show another
            thing.
        thickness_std: standard deviation of a thickness that is known, m.
        sunk_margin: by how much a surface may lie inside what a CAD file says is solid, and how
            far beside it, m.
    """

    yaws: int = 72
    max_candidates: int = 8
    similar_share: float = 0.05
    max_distance: float = 0.003
    thickness_std: float = 1e-6
    sunk_margin: float = 0.003


SETTINGS = PlacementSettings()


@dataclass(frozen=True, eq=False)
class PlacedWall(WallShape):
    """A fixed shape somewhere in the world.

    Attributes:
        params: (3,) x, y (m) and yaw (rad) of the shape's own frame.
        shape: in its own frame.
    """

    shape: WallShape

    @property
    @override
    def kind(self) -> str:
        return self.shape.kind

    @property
    @override
    def prior_std(self) -> np.ndarray:
        return np.array([SHAPE_SETTINGS.place_std, SHAPE_SETTINGS.place_std,
                         SHAPE_SETTINGS.yaw_std])

    @property
    @override
    def center(self) -> np.ndarray:
        return self.params[:2]

    @property
    @override
    def yaw(self) -> float:
        return float(self.params[2])

    @override
    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        return self.shape.depth_inside(self._to_own_frame(xy), below)

    @override
    def outward_normals(self, xy: np.ndarray) -> np.ndarray:
        normals = self.shape.outward_normals(self._to_own_frame(xy))
        return normals @ rotation_2d(self.params[2]).T

    @override
    def ring(self, below: float, inwards: float) -> np.ndarray:
        return self.shape.ring(below, inwards) @ rotation_2d(self.params[2]).T + self.params[:2]

    @override
    def offset_inwards(self, inwards: float) -> PlacedWall:
        return PlacedWall(self.params, self.shape.offset_inwards(inwards))

    @override
    def in_own_frame(self) -> WallShape:
        return self.shape

    def _to_own_frame(self, xy: np.ndarray) -> np.ndarray:
        """(n, 2) world points in the shape's own frame."""
        return (xy - self.params[:2]) @ rotation_2d(self.params[2])


def place_container(taught: TaughtContainer, surface: FusedSurface, views: list[View],
                    region: Region, voxel_size: float, config: ReconstructorConfig,
                    unit_volume: float = 0.0) -> Container:
    """Finds where a taught container stands in this scan.

    Args:
        taught: its shape and sizes.
        surface: fused from the views.
        views: with depth.
        region: where to look. The container's underside is taken to lie where the rim's height
            puts it, as that is how the floor below the stack stands to the surface above it.
        voxel_size: metres.
        config: `container_pose`, and with it `container_xyyaw`; `container_base_m`; `container`
            names it in errors.
        unit_volume: volume of one part, m3; 0: not known.

    Raises:
        ScanError: no rim of that outline, several containers, or one that reaches beyond a
            configured region or stands lower than its height would have it.
    """
    taught, rim_by_cad = _as_fused(taught, voxel_size), taught.rim_m
    # Candidate poses: configured, or where the outline meets the rim.
    top = rim_map(surface, region, voxel_size)
    candidates, expected_rim = _find_candidates(taught, top, region, config, unit_volume)
    # Height of the underside by that of the rim.
    rim = measure_rim_height(top, candidates[0], taught.wall_m, expected_rim)
    base = rim - taught.rim_m
    region = replace(region, plane_z=region.plane_z + base)
    wall = candidates[0]
    if config.container_pose != "given":
        # The candidate that the walls agree with, fitted to them.
        points = find_face_points(views, region, wall, taught.rim_m)
        wall = min(candidates, key=lambda w: _face_distance(w, points, taught.wall_m)
                   + _sunk_depth(w, taught, top, base))
        thickness = Thickness(taught.wall_m, SETTINGS.thickness_std)
        fitted = fit_wall(wall, points, taught.rim_m, thickness, region.noise)
        wall = wall.with_params(fitted.shape.params)
    _check_walls_end(wall, views, replace(region, plane_z=region.plane_z - base), rim, base,
                     config.container)
    container = make_container(wall, taught.wall_m, taught.rim_m, taught.floor_m, region.plane_z)
    check_reach(container, region)
    return container if taught.inner_map is None else with_inner_map(
        container, taught.inner_map, rim_by_cad)


def _as_fused(taught: TaughtContainer, voxel_size: float) -> TaughtContainer:
    """A container as its scan shows it: a rim that a CAD file says is worn, a measured one was."""
    if taught.inner_map is None:
        return taught
    return replace(taught, rim_m=taught.rim_m - worn_rim_height(taught.wall_m, voxel_size))


def _find_candidates(taught: TaughtContainer, top: HeightMap, region: Region,
                     config: ReconstructorConfig, unit_volume: float
                     ) -> tuple[list[PlacedWall], float]:
    """Poses in which a taught container may stand, and the height of its rim there, metres.

    Raises:
        ScanError: no rim of that outline, or several containers.
    """
    openings = find_openings(top, unit_volume)
    if len(openings) == 1:
        top = isolate_opening(top, openings[0])
    # The rim of one that stands on the plane, or on a configured base; then any rim.
    if np.isfinite(config.container_base_m):
        heights = [config.container_base_m + taught.rim_m]
    else:
        heights = [taught.rim_m, find_rim_points(top, region.noise_height).height]
    if config.container_pose == "given":
        placed = PlacedWall(np.array(config.container_xyyaw), taught.wall_shape)
        shares = [measure_outline_share(
            placed, find_rim_points(top, region.noise_height, height).xy, top.pitch)
            for height in heights]
        return [placed], heights[int(np.argmax(shares))]
    refusals = []
    for height in heights:
        try:
            return _fit_to_rim(taught, top, region.noise_height, height, config.container), height
        except ScanError as error:
            refusals.append(error)
    raise several_containers(openings, region) if len(openings) > 1 else refusals[0]


def _check_walls_end(wall: PlacedWall, views: list[View], region: Region, rim: float, base: float,
                     name: str) -> None:
    """Refuses a raised container whose walls are seen below its underside: it is another one.

    Args:
        wall: placed.
        views: with depth.
        region: with the support plane.
        rim, base: heights of its rim and its underside above that plane, metres.
        name: of the container.

    Raises:
        ScanError: they are.
    """
    if base < BASE_SETTINGS.min_height:
        return
    points = find_face_points(views, region, wall, rim)
    if find_lower_edge(wall, points, rim) < base - BASE_SETTINGS.min_height:
        raise ScanError(f"container '{name}' not found: a rim {rim:.3f} m high with walls below "
                        f"{base:.3f} m; expected {rim - base:.3f} m from rim to underside")


def _fit_to_rim(taught: TaughtContainer, top: HeightMap, min_height: float, rim_height: float,
                name: str) -> list[PlacedWall]:
    """The wall in all the poses in which its outline meets a rim of that height.

    An outline with symmetries has several.

    Raises:
        ScanError: there is none.
    """
    s = SETTINGS
    # Try all yaws about the rim's middle.
    points = find_rim_points(top, min_height, rim_height)
    level, scale = np.zeros(len(points.xy)), rim_point_std(top.pitch)
    turned = [PlacedWall(np.append(points.center, yaw), taught.wall_shape)
              for yaw in 2 * np.pi * np.arange(s.yaws) / s.yaws]
    # The logarithm: what hangs over the rim is far off.
    error = np.array([np.log1p(np.abs(wall.depth_inside(points.xy, level)) / scale).sum()
                      for wall in turned])
    # Fit the best of those that are better than their neighbours.
    best = np.nonzero((error <= np.roll(error, 1)) & (error <= np.roll(error, -1)))[0]
    chosen = best[np.argsort(error[best], kind="stable")[:s.max_candidates]]
    walls = [fit_outline(turned[i], points.xy, scale) for i in chosen]
    # Keep those that explain the rim about as well as the best.
    shares = [measure_outline_share(wall, points.xy, top.pitch) for wall in walls]
    if max(shares) < DETECTION_SETTINGS.min_rim:
        raise ScanError(f"container '{name}' not found: a rim {taught.rim_m:.3f} m high on "
                        f"{max(shares):.0%} of its outline; expected "
                        f"{DETECTION_SETTINGS.min_rim:.0%}")
    return [wall for wall, share in zip(walls, shares) if share > max(shares) - s.similar_share]


def _face_distance(wall: PlacedWall, points: FacePoints, thickness: float) -> float:
    """Mean distance of points from the face they were seen on, metres; robust."""
    distance = wall.depth_inside(points.xy, points.below) - thickness * points.inner
    return float(np.minimum(np.abs(distance), SETTINGS.max_distance).mean())


def _sunk_depth(wall: PlacedWall, taught: TaughtContainer, top: HeightMap, base: float) -> float:
    """Mean depth of the surface inside what is solid with a container in that pose, metres.

    An outline may look the same after half a turn when a ledge at one end does not.

    Args:
        wall: the pose.
        taught: the container; without an inner map nothing speaks against any pose.
        top: highest surface.
        base: height of the container's underside above the map's plane, metres.
    """
    if taught.inner_map is None:
        return 0.0
    s, T = SETTINGS, top.T_world_map
    rows, cols = np.nonzero(np.isfinite(top.heights))
    xy = (np.stack([cols, rows], axis=1) + 0.5) * top.pitch @ T[:2, :2].T + T[:2, 3]
    local = (xy - wall.params[:2]) @ rotation_2d(wall.params[2])
    solid = sample_heights(grown_downwards(taught.inner_map, s.sunk_margin), local) + base
    sunk = solid - top.heights[rows, cols] - s.sunk_margin
    inside = np.isfinite(sunk)
    return float(np.maximum(sunk[inside], 0.0).mean()) if inside.any() else 0.0
