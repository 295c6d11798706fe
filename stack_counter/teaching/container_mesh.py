# SPDX-License-Identifier: Apache-2.0
"""From a container's CAD file to what is known of it: `container teach NAME --mesh FILE`.

The rim is found in the heights of the mesh by what finds it in a scan, so that what is stored is
what placement looks for; the inner surface is kept as it is, with ledges, ribs and round corners.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np
import trimesh
from scipy import ndimage

from stack_counter import geometry
from stack_counter.container.catalogue import TaughtContainer
from stack_counter.container.detection import SETTINGS as DETECTION_SETTINGS
from stack_counter.container.inner_map import trace_outlines
from stack_counter.container.rim import Rim, find_rim, measure_rim_height
from stack_counter.container.wall_fit import SETTINGS as FIT_SETTINGS
from stack_counter.container.wall_fit import FacePoints, FittedWall, Thickness, fit_wall
from stack_counter.container.wall_shapes import BoxWall
from stack_counter.errors import MeshError
from stack_counter.fusion.surface import FusedSurface
from stack_counter.lean_open3d import o3d
from stack_counter.parts.solid_mesh import ExpectedSolid, load_solid
from stack_counter.types import HeightMap, InnerMap, Mesh, WallShape

UP_AXES = {"z": (0, 0, 1), "y": (0, 1, 0), "x": (1, 0, 0),
           "-z": (0, 0, -1), "-y": (0, -1, 0), "-x": (-1, 0, 0)}
_CONTAINER = ExpectedSolid("container", (0.04, 2.0),
                           "the container alone, without lid, label or content")


@dataclass(frozen=True)
class ContainerMeshSettings:
    """How finely a CAD file is looked at, and what counts as open; all chosen.

    Attributes:
        map_pitch: least side of a cell of the maps, m.
        map_cells: largest number of cells along a side of the maps.
        margin: empty border of the map in which the rim is looked for, m.
        floor_percentile: percentile of the inner surface's heights that is called the floor: lower
            are only the feet's pockets.
        max_through: largest share of the opening through which one can look: drain holes may be.
        directions: number of directions in which the wall is sampled.
        levels: number of heights at which the wall is sampled.
        thickness_std: standard deviation of the wall's thickness by its rim, m.
    """

    map_pitch: float = 0.0005
    map_cells: int = 800
    margin: float = 0.01
    floor_percentile: float = 10.0
    max_through: float = 0.5
    directions: int = 360
    levels: int = 36
    thickness_std: float = 0.0001


SETTINGS = ContainerMeshSettings()


@dataclass(frozen=True, eq=False)
class _Model:
    """A container's mesh as it stands: z up, its lowest point at height 0.

    Attributes:
        name: of its file.
        surface: for rays from above.
        scene: for rays from the side.
        low, high: (2,) corners of its bounding box, metres.
    """

    name: str
    surface: FusedSurface
    scene: o3d.t.geometry.RaycastingScene
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True, eq=False)
class _Inside:
    """The inner surface in a wall's own frame, and the height of its floor, metres."""

    inner_map: InnerMap
    floor: float


def teach_from_mesh(path: Path, unit: str = "mm", up: str = "z") -> TaughtContainer:
    """Takes walls, floor and inner surface of a container from its CAD file.

    Args:
        path: STL, OBJ, PLY, OFF or STEP.
        unit: unit of the file's numbers, a key of `solid_mesh.UNITS`; STEP files name their own.
        up: axis of the file along which the container is open, a key of `UP_AXES`.

    Raises:
        FileNotFoundError: no such file.
        MeshError: not one closed solid of a plausible size, or no open container with a level
            rim and a floor.
    """
    solid = load_solid(path, unit, _CONTAINER)
    model = _stand_up(solid.mesh, up, path.name)
    # Rim and wall as a scan would find them.
    top = _map_from_above(model)
    rim = _require_open_rim(model, top, solid.mesh, up)
    wall = _fit_wall(model, rim)
    rim_m = measure_rim_height(top, wall.shape, wall.thickness, rim.height)
    # The inner surface in the frame of that wall.
    inside = _map_inside(model, wall.shape, wall.thickness, rim_m)
    return TaughtContainer(wall.shape.in_own_frame(), wall.thickness, inside.floor, rim_m,
                           f"{date.today()} from {path.name}, unit {unit}", inside.inner_map)


def _stand_up(mesh: trimesh.Trimesh, up: str, name: str) -> _Model:
    """The mesh with one of its axes up, on the plane z = 0."""
    turned = mesh.copy()
    turned.apply_transform(trimesh.geometry.align_vectors(UP_AXES[up], UP_AXES["z"]))
    turned.apply_translation([0, 0, -turned.bounds[0, 2]])
    vertices, faces = turned.vertices.astype(np.float32), turned.faces.astype(np.int32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices, faces.astype(np.uint32))
    return _Model(name, FusedSurface(Mesh(vertices, faces)), scene, turned.bounds[0, :2],
                  turned.bounds[1, :2])


def _map_from_above(model: _Model) -> HeightMap:
    """Map of the whole model on a plane, in which the rim is looked for as in that of a scan."""
    size = model.high - model.low + 2 * SETTINGS.margin
    pitch = max(SETTINGS.map_pitch, float(size.max()) / SETTINGS.map_cells)
    cols, rows = (int(n) for n in np.ceil(size / pitch))
    T_world_map = geometry.pose(np.eye(3), np.append(model.low - SETTINGS.margin, 0.0))
    top = model.surface.heights(T_world_map, pitch, (rows, cols))
    return replace(top, heights=np.nan_to_num(top.heights))


def _require_open_rim(model: _Model, top: HeightMap, mesh: trimesh.Trimesh, up: str) -> Rim:
    """The rim of a model that is open upwards.

    Raises:
        MeshError: it is not; the error names the axis along which it is.
    """
    rim = find_rim(top, DETECTION_SETTINGS.min_rim_height, "auto")
    if rim is not None and _is_open(rim):
        return rim
    others = [axis for axis in UP_AXES if axis != up and _opens_along(mesh, axis)]
    advice = f"it opens along {' or '.join(others)}: --up={others[0]}" if others else \
        "export it without lid and content, standing level, its opening along one of the axes"
    share, least = 0.0 if rim is None else rim.outline_share, DETECTION_SETTINGS.min_rim
    seen = "is closed at the top" if share >= least else \
        f"has a level rim on {share:.0%} of its outline, less than {least:.0%}"
    raise MeshError(f"{model.name} {seen}, {up} being up; expected an open container: {advice}")


def _opens_along(mesh: trimesh.Trimesh, axis: str) -> bool:
    """Whether a mesh is open upwards once that axis is up."""
    rim = find_rim(_map_from_above(_stand_up(mesh, axis, "")), DETECTION_SETTINGS.min_rim_height,
                   "auto")
    return rim is not None and _is_open(rim)


def _is_open(rim: Rim) -> bool:
    """Whether a rim is level all around and the surface falls inside it."""
    return rim.outline_share >= DETECTION_SETTINGS.min_rim and np.isfinite(rim.width) \
        and rim.inner_drop_share >= DETECTION_SETTINGS.min_drop


def _fit_wall(model: _Model, rim: Rim) -> FittedWall:
    """The wall below a rim, fitted to points of both of its faces; a box lies along x."""
    shape = rim.outline
    if isinstance(shape, BoxWall) and shape.params[3] < shape.params[4]:
        x, y, yaw, width, length, draft = shape.params
        shape = BoxWall(np.array([x, y, yaw + np.pi / 2, length, width, draft]))
    inside = _map_inside(model, shape, rim.width, rim.height)
    levels = np.linspace(FIT_SETTINGS.foot, rim.height - FIT_SETTINGS.edge, SETTINGS.levels)
    # Outer face: what rays from outside towards the middle meet first.
    angle = 2 * np.pi * np.arange(SETTINGS.directions) / SETTINGS.directions
    outwards = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    far = float(np.linalg.norm(model.high - model.low))
    origins = np.concatenate([np.column_stack([shape.center + far * outwards,
                                               np.full(len(angle), z)]) for z in levels])
    rays = np.tile(np.pad(-outwards, ((0, 0), (0, 1))), (len(levels), 1))
    hits = model.scene.cast_rays(np.concatenate([origins, rays], 1).astype(np.float32))["t_hit"]
    length = hits.numpy()
    outer = (origins + np.where(np.isfinite(length), length, 0)[:, None] * rays)[length < far]
    # Inner face: outlines of the inner surface above the floor.
    levels = levels[levels > inside.floor + FIT_SETTINGS.foot]
    c, s = np.cos(shape.yaw), np.sin(shape.yaw)
    rings = trace_outlines(inside.inner_map, levels, inside.floor, rim.height).reshape(-1, 3)
    inner = np.column_stack([rings[:, :2] @ np.array([[c, s], [-s, c]]) + shape.center,
                             rings[:, 2]])
    points = np.concatenate([outer, inner])
    faces = FacePoints(points[:, :2], rim.height - points[:, 2],
                       np.arange(len(points)) >= len(outer))
    return fit_wall(shape, faces, rim.height, Thickness(rim.width, SETTINGS.thickness_std),
                    noise=0.0)


def _map_inside(model: _Model, shape: WallShape, thickness: float, rim_m: float) -> _Inside:
    """The inner surface over the opening of a wall, in the wall's own frame.

    Raises:
        MeshError: there is no floor, or it is hardly below the rim.
    """
    # A map around the outline, centred on the wall's middle.
    own = shape.in_own_frame()
    half = np.abs(own.ring(0.0, 0.0)).max(axis=0)
    pitch = max(SETTINGS.map_pitch, 2 * float(half.max()) / SETTINGS.map_cells)
    half_cols, half_rows = (int(n) for n in np.ceil(half / pitch))
    c, s = np.cos(shape.yaw), np.sin(shape.yaw)
    T_world_own = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
                                np.append(shape.center, 0.0))
    corner = np.array([-half_cols * pitch, -half_rows * pitch, 0.0])
    seen = model.surface.heights(T_world_own @ geometry.pose(np.eye(3), corner), pitch,
                                 (2 * half_rows, 2 * half_cols))
    # Up to the middle of the rim; beyond it is outside.
    rows, cols = np.mgrid[:2 * half_rows, :2 * half_cols]
    xy = corner[:2] + (np.stack([cols.ravel(), rows.ravel()], axis=1) + 0.5) * pitch
    within = (own.depth_inside(xy, np.zeros(len(xy))) > thickness / 2).reshape(rows.shape)
    within &= ndimage.binary_fill_holes(np.isfinite(seen.heights))  # not beside round corners
    through = np.isnan(seen.heights) & within
    if through.sum() > SETTINGS.max_through * within.sum():
        raise MeshError(f"{model.name} is open below on {through.sum() / within.sum():.0%} of its "
                        "opening; expected a container with a floor")
    floor = float(np.percentile(seen.heights[within & ~through], SETTINGS.floor_percentile))
    if rim_m - floor < DETECTION_SETTINGS.min_rim_height:
        raise MeshError(f"{model.name} is {(rim_m - floor) * 1000:.1f} mm deep; expected "
                        f"{DETECTION_SETTINGS.min_rim_height * 1000:.0f} mm or more below its rim")
    heights = np.where(through, np.float32(floor), seen.heights)
    return _Inside(InnerMap(pitch, np.where(within, heights, np.float32(np.nan))), floor)
