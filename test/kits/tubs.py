# SPDX-License-Identifier: Apache-2.0
"""Containers made of outlines, drafted, stepped or round, filled bumpily to a known volume."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.types import Mesh

WALL = FLOOR = 0.003


@dataclass(frozen=True, eq=False)
class Tub:
    """A container on z = 0: (height, (n, 2) outline) pairs of both faces, from below, metres."""

    inner: list[tuple[float, np.ndarray]]
    outer: list[tuple[float, np.ndarray]]

    @property
    def rim(self):
        """Height of the rim, metres."""
        return self.inner[-1][0]

    def solid(self):
        """The container as a closed `trimesh` solid, metres."""
        rings = [np.pad(outline, ((0, 0), (0, 1)), constant_values=z)
                 for z, outline in (*self.outer, *self.inner[::-1])]
        return trimesh.Trimesh(*_solid_of_rings(rings))

    def volume(self, level):
        """Volume inside up to a height, m3: Simpson's rule is exact between two outlines."""
        volume = 0.0
        for (z0, a), (z1, b) in pairwise(self.inner):
            top = np.clip(level, z0, z1)
            if z1 > z0:
                areas = [_area(a + (b - a) * (z - z0) / (z1 - z0))
                         for z in (z0, (z0 + top) / 2, top)]
                volume += (top - z0) * np.dot(areas, [1, 4, 1]) / 6
        return float(volume)

    def scene(self, share, pose=(0.0, 0.0, 0.0), bump=0.006):
        """The container somewhere, filled to a share of its depth with bumps on it.

        Returns:
            `Scene` and the volume of the filling, m3.
        """
        meshes, volume = self.meshes(share, pose, bump)
        scene = Scene()
        for mesh in meshes:
            scene.mesh(mesh)
        return scene, volume

    def meshes(self, share, pose=(0.0, 0.0, 0.0), bump=0.006):
        """Container and filling, `types.Mesh` in the world, and the filling's volume, m3."""
        level = self.inner[0][0] + share * (self.rim - self.inner[0][0])
        filling, volume = self._filling(level, bump)
        x, y, yaw = pose
        c, s = np.cos(yaw), np.sin(yaw)
        T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([x, y, 0.0]))
        solid = self.solid()
        return [Mesh(geometry.apply(T, vertices).astype(np.float32), faces.astype(np.int32))
                for vertices, faces in ((solid.vertices, solid.faces), filling)], volume

    def _filling(self, level, bump):
        """Vertices and faces of a bumpy surface up to the wall, and the volume below it."""
        (z0, a), (z1, b) = next((low, high) for low, high in pairwise(self.inner)
                                if low[0] <= level <= high[0] > low[0])
        outline = _finely(a + (b - a) * (level - z0) / (z1 - z0))
        # Rings from the middle to the wall, the bumps vanishing there.
        share = np.linspace(0, 1, 41)[:, None]
        xy = share[..., None] * outline
        waves = np.sin(2 * np.pi / 0.03 * xy[..., 0] + 1) * np.sin(2 * np.pi / 0.03 * xy[..., 1])
        rings = np.concatenate([xy, (level + bump * (1 - share**6) * waves)[..., None]], axis=-1)
        n = len(outline)
        faces = _faces_between_rings(len(rings), n)
        vertices = rings.reshape(-1, 3)
        corners = vertices[faces]
        sides = corners[:, 1:, :2] - corners[:, :1, :2]
        areas = (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
        above = float(np.sum(areas * (corners[..., 2].mean(axis=1) - level)))
        return (vertices, faces), self.volume(level) + above


def drafted_box(rim=(0.3, 0.2), depth=0.12, degrees=5.0, corner=0.0):
    """A box whose walls all have the same draft; its corners may be round."""
    slope = np.tan(np.deg2rad(degrees))

    def outline(z, outwards):
        grown = 2 * (outwards - slope * (FLOOR + depth - z))
        return rectangle(rim[0] + grown, rim[1] + grown, corner and corner + outwards)
    return Tub([(z, outline(z, 0.0)) for z in (FLOOR, FLOOR + depth)],
               [(z, outline(z, WALL)) for z in (0.0, FLOOR + depth)])


def stepped_box(rim=(0.3, 0.2), depth=0.14, ledge=0.012, at_end_only=False):
    """An upright box with a ledge half way up all around, or at the end of -x only."""
    (x, y), middle, top = rim, FLOOR + depth / 2, FLOOR + depth
    wide = rectangle(x, y)
    narrow = wide + [ledge, 0] * (wide[:, :1] < 0) if at_end_only \
        else rectangle(x - 2 * ledge, y - 2 * ledge)
    outer = rectangle(x + 2 * WALL, y + 2 * WALL)
    return Tub([(FLOOR, narrow), (middle, narrow), (middle, wide), (top, wide)],
               [(0.0, outer), (top, outer)])


def bucket(rim=0.14, foot=0.11, depth=0.2):
    """A cone with a flat floor; radii inside, metres."""
    top, slope = FLOOR + depth, (rim - foot) / depth
    return Tub([(FLOOR, circle(foot)), (top, circle(rim))],
               [(0.0, circle(foot - slope * FLOOR + WALL)), (top, circle(rim + WALL))])


def rectangle(x, y, corner=0.0):
    """(n, 2) counter-clockwise outline of sides x and y, metres, with round corners or sharp."""
    if not corner:
        return np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2
    arcs = []
    for quarter, signs in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = np.pi / 2 * (quarter + np.linspace(0, 1, 9))
        arcs.append(np.array(signs) * (np.array([x, y]) / 2 - corner)
                    + corner * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(arcs)


def circle(radius):
    """(96, 2) counter-clockwise outline, metres."""
    angle = 2 * np.pi * np.arange(96) / 96
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _area(outline):
    (x, y), (u, w) = outline.T, np.roll(outline, -1, axis=0).T
    return np.sum(x * w - u * y) / 2


def _finely(outline, step=0.004):
    """The outline with corners at most so far apart."""
    return np.concatenate([
        a + (b - a) * np.arange(n)[:, None] / n
        for a, b in zip(outline, np.roll(outline, -1, axis=0))
        for n in [max(int(np.linalg.norm(b - a) / step), 1)]])


def _faces_between_rings(count, n):
    """Triangles between `count` rings of n corners each, one after the other."""
    a, b = np.arange(n), np.roll(np.arange(n), -1)
    quads = np.concatenate([np.stack([a, a + n, b + n], 1), np.stack([a, b + n, b], 1)])
    return np.concatenate([quads + i * n for i in range(count - 1)])


def _solid_of_rings(rings):
    """Vertices and faces of rings from outside below over the rim to the floor, closed by fans."""
    count, n = len(rings), len(rings[0])
    a, b = np.arange(n), np.roll(np.arange(n), -1)
    vertices = np.concatenate([*rings, [rings[-1].mean(axis=0), rings[0].mean(axis=0)]])
    last = (count - 1) * n
    faces = np.concatenate([_faces_between_rings(count, n)[:, ::-1],
                            np.stack([a + last, b + last, np.full(n, count * n)], 1),
                            np.stack([b, a, np.full(n, count * n + 1)], 1)])
    return vertices, faces
