# SPDX-License-Identifier: Apache-2.0
"""Solids by manifold3d that several families share. Lengths are in part sizes, about 1."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold, OpType

# Segments of a circle; chosen.
SIDES = 28


def box(*size: float) -> Manifold:
    """A box of three sides about the origin."""
    return Manifold.cube(size, True)


def cylinder(height: float, radius: float, sides: int = SIDES) -> Manifold:
    """An upright cylinder or regular prism about the origin."""
    return Manifold.cylinder(height, radius, radius, sides, True)


def polygon(points: np.ndarray) -> CrossSection:
    """A closed outline from (n, 2) points, counter-clockwise."""
    return CrossSection([np.asarray(points, float)])


def polar(radii: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """(n, 2) points from radii (n,) and angles (n,), radians."""
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)


def union(solids: list[Manifold]) -> Manifold:
    """The union of all solids."""
    return Manifold.batch_boolean(solids, OpType.Add)


def largest(solid: Manifold) -> Manifold:
    """The piece of the largest volume; an empty solid stays empty."""
    return max(solid.decompose(), key=Manifold.volume, default=solid)


def rotated(solid: Manifold, random: np.random.Generator) -> Manifold:
    """The solid at a random attitude."""
    return solid.rotate(random.uniform(0, 360, 3))


def direction(random: np.random.Generator) -> np.ndarray:
    """(3,) random unit vector."""
    v = random.normal(size=3)
    return v / np.linalg.norm(v)


def bar(a: np.ndarray, b: np.ndarray, radius_a: float, radius_b: float, sides: int) -> Manifold:
    """The hull of two balls: at point a (3,) with radius_a, and at b."""
    return Manifold.batch_hull([Manifold.sphere(radius_a, sides).translate(a),
                                Manifold.sphere(radius_b, sides).translate(b)])


def sweep(profile: CrossSection, path: np.ndarray) -> Manifold:
    """Moves a profile along a path that is nowhere parallel to z.

    Args:
        profile: its x points sideways, its y upwards.
        path: (n, 3) points.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0, 0, 1])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)

    def place(p: np.ndarray) -> np.ndarray:
        i = np.rint(p[:, 2]).astype(int)
        return path[i] + p[:, :1] * -side[i] + p[:, 1:2] * up[i]

    return profile.extrude(len(path) - 1, len(path) - 2).warp_batch(place)
