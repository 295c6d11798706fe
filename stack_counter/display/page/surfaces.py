# SPDX-License-Identifier: Apache-2.0
"""What the model and its picture show: the carved surface, and lines along the container."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.display.mesh_colors import display_colors
from stack_counter.display.mesh_decimation import decimate
from stack_counter.types import Container, HeightMap, KeyView, Mesh, StackVolume, View


@dataclass(frozen=True)
class SurfaceSettings:
    """How much is shown, and how; all chosen.

    Attributes:
        max_triangles: of the surface over the stack; with those around it, they keep the page
            below 4 MB.
        max_triangles_around: of what stands around the stack.
        max_voxels: of a hull, which is shown as cubes.
        margin: room around the stack that is shown, in the larger side of the stack.
        line_width: width of the container's lines, in the larger side of its rim.
        wall_lines: about so many lines are drawn from rim to floor.
        line_color: RGB of the lines: blue, which those who see no red or green tell apart too.
        key_view_tolerance_m: distance up to which the key view's depth shows a place, m.
        floor_tolerance_m: height above the floor up to which the inner surface is floor, m.
    """

    max_triangles: int = 32_000
    max_triangles_around: int = 12_000
    max_voxels: int = 3_500
    margin: float = 0.15
    line_width: float = 0.009
    wall_lines: int = 8
    line_color: tuple[int, int, int] = (0, 114, 178)
    key_view_tolerance_m: float = 0.01
    floor_tolerance_m: float = 0.002


SETTINGS = SurfaceSettings()


def surface_to_show(volume: StackVolume) -> Mesh | None:
    """Returns the surface around the stack, with colours and few enough triangles.

    That is the carved one; cubes where only a hull's points are known; the map of the top
    surface where the mesh is not known, as in a volume that came by message.
    """
    mesh = volume.mesh
    if mesh is not None and len(mesh.triangles):
        mesh = _decimate_around(mesh, volume.top)
    elif mesh is not None and len(mesh.vertices):
        mesh = _cubes(mesh.vertices)
    elif volume.top is not None and np.isfinite(volume.top.heights).any():
        mesh = _relief(volume.top, volume.key_view)
    if mesh is None or not len(mesh.triangles):
        return None
    return replace(mesh, colors=display_colors(mesh))


def container_to_show(volume: StackVolume) -> Mesh | None:
    """Returns bars along rim, floor and walls of the container; None where none is known."""
    rings = container_rings(volume)
    if rings is None:
        return None
    width = SETTINGS.line_width * float(np.ptp(rings[-1], axis=0).max())
    rings[-1, :, 2] += width / 2  # clear of the carved rim
    step = max(rings.shape[1] // SETTINGS.wall_lines, 1)
    lines = [np.concatenate([ring, ring[:1]]) for ring in (rings[0], rings[-1])]
    corners = _corners(rings[-1])
    columns = corners if len(corners) <= SETTINGS.wall_lines else range(0, rings.shape[1], step)
    lines += [rings[:, column] for column in columns]
    bars = [_bar(a, b, width) for line in lines for a, b in zip(line[:-1], line[1:])]
    vertices = np.concatenate(bars).astype(np.float32)  # (8 n, 3)
    triangles = (np.arange(len(bars))[:, None, None] * 8 + _BOX_TRIANGLES).reshape(-1, 3)
    colors = np.tile(np.array(SETTINGS.line_color, np.uint8), (len(vertices), 1))
    return Mesh(vertices, triangles.astype(np.int32), colors)


def container_rings(volume: StackVolume) -> np.ndarray | None:
    """Returns outlines of the inner wall from floor to rim: (k, n, 3) metres, world; or None.

    A container that came by message has none: then they follow from the map of its inner surface.
    """
    container = volume.container
    if container.rings is not None:
        rings = container.rings[container.rings[:, 0, 2] >= container.floor_thickness_m]
        return geometry.apply(container.T_world_container, rings)
    if volume.inner is None or not any(container.inner_size_m):
        return None
    return _rings_of_map(volume.inner, container)


def _rings_of_map(inner: HeightMap, container: Container) -> np.ndarray | None:
    """Returns (2, n, 3) the outline of the opening at the height of floor and rim, world."""
    opening = np.isfinite(inner.heights).astype(np.uint8)
    outlines, _ = cv2.findContours(opening, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return None
    outline = cv2.approxPolyDP(max(outlines, key=cv2.contourArea), 1.0, True)[:, 0]
    xy = (outline + 0.5) * inner.pitch
    rings = [np.column_stack([xy, np.full(len(xy), z)])
             for z in (container.floor_thickness_m, container.outer_size_m[2])]
    return geometry.apply(inner.T_world_map, np.stack(rings))


def _corners(ring: np.ndarray) -> np.ndarray:
    """Returns the indices at which an outline (n, 3) turns by more than 30 degrees."""
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    cosine = (before * after).sum(axis=1) / np.maximum(
        np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1), 1e-12)
    return np.flatnonzero(cosine < np.cos(np.deg2rad(30)))


# Corner 4 a + 2 b + c lies at (a, b, c) of a right-handed frame; outer faces counter-clockwise.
_BOX_TRIANGLES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                           [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])


def _bar(start: np.ndarray, end: np.ndarray, width: float) -> np.ndarray:
    """Returns the (8, 3) corners of a square bar between two (3,) points, a little longer."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length if length else np.array([0.0, 0, 1])
    other = np.array([0.0, 0, 1]) if abs(along[2]) < 0.9 else np.array([1.0, 0, 0])
    side = np.cross(along, other)
    side *= width / 2 / np.linalg.norm(side)
    up = np.cross(along, side)
    ends = (start - along * width / 2, end + along * width / 2)
    return np.array([p + a * side + b * up for p in ends for a in (-1, 1) for b in (-1, 1)])


def _decimate_around(mesh: Mesh, top: HeightMap | None) -> Mesh:
    """Returns a mesh with few triangles, most of them over the footprint of the map.

    What lies farther from that than the margin is left out.
    """
    if top is None or not np.isfinite(top.heights).any():
        return decimate(mesh, SETTINGS.max_triangles + SETTINGS.max_triangles_around)
    # Find the cell of the map below each vertex.
    xy = geometry.apply(geometry.inverse(top.T_world_map), mesh.vertices.astype(float))[:, :2]
    footprint = np.isfinite(top.heights)
    cols, rows = np.floor(xy / top.pitch).astype(int).T
    over = (rows >= 0) & (rows < footprint.shape[0]) & (cols >= 0) & (cols < footprint.shape[1])
    over[over] = footprint[rows[over], cols[over]]
    # Leave out what is far from all of them.
    marked = np.argwhere(footprint)[:, ::-1] * top.pitch
    low, high = marked.min(axis=0), marked.max(axis=0) + top.pitch
    margin = SETTINGS.margin * float((high - low).max())
    near = ((xy > low - margin) & (xy < high + margin)).all(axis=1)
    # Decimate each by itself.
    is_over = over[mesh.triangles].any(axis=1)
    is_around = ~is_over & near[mesh.triangles].all(axis=1)
    return _joined([decimate(_without_unused(mesh, mesh.triangles[kept]), most)
                    for kept, most in ((is_over, SETTINGS.max_triangles),
                                       (is_around, SETTINGS.max_triangles_around))])


def _joined(meshes: list[Mesh]) -> Mesh:
    """Returns two or more meshes, all with colours or none, as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    colors = [mesh.colors for mesh in meshes if mesh.colors is not None]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]),
                np.concatenate([m.triangles + n for m, n in zip(meshes, starts)]).astype(np.int32),
                np.concatenate(colors) if colors else None)


def _without_unused(mesh: Mesh, triangles: np.ndarray) -> Mesh:
    """Returns a mesh of some of its triangles (m, 3), without the other vertices."""
    used, triangles = np.unique(triangles, return_inverse=True)
    colors = None if mesh.colors is None else mesh.colors[used]
    return Mesh(mesh.vertices[used], triangles.reshape(-1, 3).astype(np.int32), colors)


def _cubes(points: np.ndarray) -> Mesh:
    """Returns a cube at each of the (n, 3) points of a grid, fewer and larger if they are many."""
    side = float(np.ptp(points, axis=0).max()) / 60 or 1e-3
    while True:
        cells = np.unique(np.floor(points / side).astype(np.int64), axis=0)
        if len(cells) <= SETTINGS.max_voxels:
            break
        side *= 1.2
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    vertices = (cells[:, None] + corners).reshape(-1, 3) * side
    triangles = (np.arange(len(cells))[:, None, None] * 8 + _BOX_TRIANGLES).reshape(-1, 3)
    return Mesh(vertices.astype(np.float32), triangles.astype(np.int32))


def _relief(top: HeightMap, key_view: KeyView | None) -> Mesh:
    """Returns a height map as a mesh, in the colours of the key view where that shows it."""
    rows, cols = np.mgrid[:top.heights.shape[0], :top.heights.shape[1]]
    grid = np.stack([(cols + 0.5) * top.pitch, (rows + 0.5) * top.pitch, top.heights], axis=-1)
    vertices = geometry.apply(top.T_world_map, grid.reshape(-1, 3).astype(float))
    index = np.arange(rows.size).reshape(rows.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3)
                                for t in ((a, b, d), (a, d, c))])
    measured = np.isfinite(top.heights).ravel()
    mesh = _without_unused(Mesh(vertices.astype(np.float32), triangles.astype(np.int32)),
                           triangles[measured[triangles].all(axis=1)])
    if key_view is None or key_view.color is None or not len(mesh.vertices):
        return decimate(mesh, SETTINGS.max_triangles)
    return decimate(replace(mesh, colors=_colors_of(key_view, mesh)), SETTINGS.max_triangles)


def _colors_of(key_view: KeyView, mesh: Mesh) -> np.ndarray:
    """Returns (n, 3) uint8 RGB: of the key view where it shows a vertex, else by height."""
    assert key_view.color is not None  # checked by the caller
    view = View(key_view.stamp_ns, key_view.intrinsics, key_view.T_world_camera, key_view.color,
                key_view.depth)
    pixels = geometry.project_into(view, mesh.vertices)
    shown = np.ones(len(pixels.rows), bool)
    if key_view.depth is not None:
        off = np.abs(key_view.depth[pixels.rows, pixels.cols] - pixels.depth)
        shown = off < SETTINGS.key_view_tolerance_m
    colors = np.full((len(mesh.vertices), 3), 128, np.uint8)
    colors[np.flatnonzero(pixels.inside)[shown]] = \
        key_view.color[pixels.rows[shown], pixels.cols[shown]]
    return colors
