"""Which way is up, where the world does not say: the plane that the background around the stack
shows, by random sampling (Fischler and Bolles, "Random Sample Consensus", 1981)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import BACKGROUND, View

_POINTS = 40_000  # of the support that are looked at
_DRAWS = 300  # planes that are tried
_FLAT = 0.004  # half thickness of a plane, m
_MIN_SHARE = 0.4  # of the background's points that must lie on the support
_UPRIGHT = np.deg2rad(3.0)  # a world that is tilted less has its z up, as in a robot's cell


def find_upright(views: list[View]) -> tuple[np.ndarray, float]:
    """T_upright_world (4, 4), a rotation that turns the support's normal to z, and the support's
    height in the upright world, metres.

    The identity where the world's own z is up. The support is the plane with the most of what
    the background around the stack shows.

    Args:
        views: with depth on some background, and labels.

    Raises:
        ScanError: too little background has depth, or no plane holds most of it.
        ViewError: reasons `no_depth`, `no_labels`.
    """
    points = np.concatenate([_background(view) for view in views])
    if len(points) < 100:
        raise ScanError(f"{len(points)} points of background have depth; expected 100 or more")
    random = np.random.default_rng(0)
    points = points[random.permutation(len(points))[:_POINTS]]
    origin, normal, share = _plane(points, random)
    if share < _MIN_SHARE:
        raise ScanError(f"the best plane holds {share:.0%} of the background; expected "
                        f"{_MIN_SHARE:.0%}: no level support in sight")
    eyes = np.mean([view.T_world_camera[:3, 3] for view in views], axis=0)
    up = normal if (eyes - origin) @ normal > 0 else -normal
    if np.arccos(np.clip(up[2], -1, 1)) < _UPRIGHT:
        return np.eye(4), float(origin[2])
    x = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0.0, 1, 0])
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    return geometry.pose(np.stack([x, np.cross(up, x), up]), np.zeros(3)), float(origin @ up)


def show_support(view: View, plane_z: float) -> View:
    """The view with the support's depth at every background pixel whose ray meets it.

    Labels know the stack's edge better than stereo does: what is background hides nothing of it.

    Args:
        view: with depth and labels; z of the world is up.
        plane_z: height of the support, metres, world.
    """
    if view.depth is None:
        raise ViewError("no_depth", "the view has no depth image; expected one")
    rays = geometry.pixel_rays(view.intrinsics)
    down = -(rays @ view.T_world_camera[2, :3].astype(np.float32))
    meets = (require_labels(view) == BACKGROUND) & (down > 0)
    height = view.T_world_camera[2, 3] - plane_z
    depth = np.where(meets, height / np.where(meets, down, 1), view.depth)
    return replace(view, depth=np.maximum(depth, 0).astype(np.float32))


def _background(view: View) -> np.ndarray:
    """(n, 3) float64 world points of the background, metres."""
    if view.depth is None:
        raise ViewError("no_depth", "the view has no depth image; expected one")
    rows, cols = np.nonzero((require_labels(view) == BACKGROUND) & (view.depth > 0))
    local = geometry.unproject(view.depth, view.intrinsics)[rows, cols].astype(float)
    return geometry.apply(view.T_world_camera, local)


def _plane(points: np.ndarray, random: np.random.Generator
           ) -> tuple[np.ndarray, np.ndarray, float]:
    """A point and the normal (3,) of the plane with the most points, and their share."""
    best, votes = (points[0], np.array([0.0, 0, 1])), -1
    for _ in range(_DRAWS):
        a, b, c = points[random.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        normal /= max(np.linalg.norm(normal), 1e-12)
        count = int(np.count_nonzero(np.abs((points - a) @ normal) < _FLAT))
        if count > votes:
            best, votes = (a, normal), count
    origin, normal = best
    for _ in range(3):
        near = points[np.abs((points - origin) @ normal) < _FLAT]
        origin = near.mean(axis=0)
        normal = np.linalg.eigh(np.cov((near - origin).T))[1][:, 0]
    return origin, normal, float((np.abs((points - origin) @ normal) < _FLAT).mean())
