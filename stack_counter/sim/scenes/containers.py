"""Containers of the simulator: one loop of wall rings for all kinds.

Every kind is a stack of closed outlines from the inner floor to the rim, the widest at the rim,
so that its rim opening is its footprint.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from stack_counter import geometry
from stack_counter.errors import StackCounterError
from stack_counter.types import Mesh

KINDS = ("bin", "cylinder", "bowl", "cup", "tray", "bag", "none")
ROUND_KINDS = ("cylinder", "bowl", "cup")
_SIDES = 48  # of a round outline
_BOWL_FOOT = 0.35  # radius of a bowl's flat floor over that of its rim
_SLOPE = 0.7  # by which collision walls grow outwards below the rim: thin walls hold fast parts


class ContainerError(StackCounterError):
    """A container of no use: an unknown kind, or sizes that leave no room inside."""
# What a reconstruction makes of a kind: one of `types.CONTAINER_KINDS`.
RECONSTRUCTED_KIND = {
    "bin": "box",
    "tray": "box",
    "cylinder": "round",
    "bowl": "round",
    "cup": "round",
    "bag": "free",
    "none": "none",
}


@dataclass(frozen=True)
class ContainerShape:
    """A simulated container, or the region of a heap.

    Attributes:
        kind: one of `KINDS`.
        T_world_container: (4, 4) float64; origin at the centre of the bottom, on the support
            plane; z up; x along the first inner side.
        inner_size_m: x and y of the rim opening's bounding box, and the depth from rim to inner
            floor; for `none` the sides of the heap's region, and 0.
        wall_thickness_m, floor_thickness_m: metres; the wall's is measured horizontally.
        draft_rad: inclination of the walls from the vertical.
        seed: of a bag's folds.
    """

    kind: str
    T_world_container: np.ndarray = field(default_factory=lambda: np.eye(4))
    inner_size_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wall_thickness_m: float = 0.0
    floor_thickness_m: float = 0.0
    draft_rad: float = 0.0
    seed: int = 0

    def __post_init__(self):
        x, y, depth = self.inner_size_m
        if self.kind not in KINDS:
            raise ContainerError(f"container kind is '{self.kind}'; expected one of {KINDS}")
        low = min(x, y) if self.kind == "none" else min(
            *self.inner_size_m, self.wall_thickness_m, self.floor_thickness_m)
        if not (low > 0 and np.isfinite([*self.inner_size_m, self.wall_thickness_m,
                                         self.floor_thickness_m]).all()):
            raise ContainerError(f"{self.kind} measures {self.inner_size_m} m inside, walls "
                                 f"{self.wall_thickness_m} m; expected all above 0")
        if not 0 <= self.draft_rad < np.pi / 4:
            raise ContainerError(f"draft is {self.draft_rad} rad; expected 0 to pi / 4")
        if 2 * depth * np.tan(self.draft_rad) > 0.8 * min(x, y):
            raise ContainerError(f"{self.kind} of {self.inner_size_m} m with a draft of "
                                 f"{np.rad2deg(self.draft_rad):.0f} degrees closes at its floor")

    @property
    def rim_height_m(self) -> float:
        """Height of the rim above the support plane; 0 for a heap."""
        return self.floor_thickness_m + self.inner_size_m[2] if self.kind != "none" else 0.0

    @cached_property
    def inner_rings(self) -> np.ndarray:
        """(k, n, 3) outlines of the inner wall, counter-clockwise, container frame, metres,
        from floor to rim; for a heap the one outline of its region."""
        x, y, depth = self.inner_size_m
        if self.kind in ("bin", "tray", "none"):
            rim = np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2
        elif self.kind == "bag":
            rim = _rounded_rectangle(x, y, 0.25 * min(x, y))
        else:
            angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
            rim = np.stack([x / 2 * np.cos(angle), y / 2 * np.sin(angle)], axis=1)
        if self.kind == "none":
            return np.pad(rim, ((0, 0), (0, 1)))[None]
        levels = np.linspace(0, 1, {"bowl": 9, "bag": 6}.get(self.kind, 2))
        rings = [np.column_stack([self._outline_at(rim, u), np.full(len(rim), u * depth)])
                 for u in levels]
        return np.array(rings) + [0, 0, self.floor_thickness_m]

    def _outline_at(self, rim: np.ndarray, level: float) -> np.ndarray:
        """(n, 2) outline at a share of the depth."""
        down = 1 - level
        if self.kind == "bowl":
            return rim * np.sqrt(1 - (1 - _BOWL_FOOT**2) * down**2)
        if self.kind == "bag":
            return rim * (1 - down * self._fold_depths(rim) - 0.10 * down**3)[:, None]
        return rim - _outward_offsets(rim) * (down * self.inner_size_m[2] * np.tan(self.draft_rad))

    def _fold_depths(self, rim: np.ndarray) -> np.ndarray:
        """(n,) how far a bag's wall leans in, as a share, around the outline: 0 to 0.12."""
        random = np.random.default_rng([self.seed, 0xBA6])
        angle = np.arctan2(rim[:, 1], rim[:, 0])
        waves = sum(random.normal() * np.cos(k * angle + random.uniform(0, 2 * np.pi)) / k
                    for k in range(2, 7))
        return 0.06 + 0.06 * np.tanh(waves)

    @property
    def opening(self) -> np.ndarray:
        """(n, 2) outline of the rim opening, counter-clockwise, container frame, metres."""
        return self.inner_rings[-1][:, :2]

    def is_over_opening(self, points: np.ndarray) -> np.ndarray:
        """(...) bool: the points (..., 2 or 3) of the container frame lie over the opening."""
        x, y = np.asarray(points)[..., 0, None], np.asarray(points)[..., 1, None]
        (ax, ay), (bx, by) = self.opening.T, np.roll(self.opening, -1, axis=0).T
        with np.errstate(divide="ignore", invalid="ignore"):
            crosses = ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
        return np.count_nonzero(crosses, axis=-1) % 2 == 1

    def mesh(self) -> Mesh | None:
        """The whole container in the world, closed; None for a heap."""
        if self.kind == "none":
            return None
        outer = self.inner_rings + _outward_moves(self.inner_rings, self.wall_thickness_m)
        foot = outer[:1] * [1, 1, 0]
        return self._mesh_from_rings(
            np.concatenate([foot, outer, self.inner_rings[::-1]]), closed=True
        )

    def inner_mesh(self) -> Mesh | None:
        """Inner wall and floor in the world, seen from inside; None for a heap."""
        if self.kind == "none":
            return None
        return self._mesh_from_rings(self.inner_rings[::-1], closed=False)

    def _mesh_from_rings(self, rings: np.ndarray, closed: bool) -> Mesh:
        """Joins rings, and ends at the middle of the last one (and of the first if closed)."""
        k, n = rings.shape[:2]
        a, b = np.arange(n), np.roll(np.arange(n), -1)
        quads = [np.concatenate([np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)])
                 + i * n for i in range(k - 1)]
        top = np.stack([a + (k - 1) * n, b + (k - 1) * n, np.full(n, k * n)], 1)
        bottom = [np.stack([b, a, np.full(n, k * n + 1)], 1)] if closed else []
        middles = [rings[-1].mean(axis=0), rings[0].mean(axis=0)][:1 + closed]
        vertices = geometry.apply(self.T_world_container,
                                  np.concatenate([rings.reshape(-1, 3), middles]))
        return Mesh(vertices.astype(np.float32),
                    np.concatenate([*quads, top, *bottom]).astype(np.int32))

    def collision_pieces(self) -> list[np.ndarray]:
        """Corners (8 or more, 3) of convex blocks in the container frame, metres: what the rays
        see, thickened outwards below the rim and the floor."""
        if self.kind == "none":
            return []
        rings = self.inner_rings
        deeper = self.wall_thickness_m + _SLOPE * (self.rim_height_m - rings[:, :, 2])
        outer = rings + _outward_moves(rings, 1.0) * deeper[..., None]
        pieces = []
        for k in range(len(rings) - 1):
            loops = np.stack([rings[k], rings[k + 1], outer[k], outer[k + 1]])  # (4, n, 3)
            pieces += list(np.concatenate([loops, np.roll(loops, -1, axis=1)]).transpose(1, 0, 2))
        below = outer[0] * [1, 1, 0] - [0, 0, self.inner_size_m[2]]
        return pieces + [np.concatenate([rings[0], below])]


def _outward_offsets(outline: np.ndarray) -> np.ndarray:
    """(n, 2) by how much each corner moves when every side moves out by one (mitred)."""
    side = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([side[:, 1], -side[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    before = np.roll(normal, 1, axis=0)
    return (normal + before) / (1 + np.sum(normal * before, axis=1, keepdims=True))


def _outward_moves(rings: np.ndarray, distance: float) -> np.ndarray:
    """(k, n, 3) horizontal outward moves of all rings' corners."""
    return (
        np.stack([np.pad(_outward_offsets(ring[:, :2]), ((0, 0), (0, 1))) for ring in rings])
        * distance
    )


def _rounded_rectangle(x: float, y: float, radius: float) -> np.ndarray:
    """(48, 2) counter-clockwise outline; 12 corners for each rounded one."""
    turn = np.linspace(0, np.pi / 2, 12)
    arc = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    corners = []
    for quarter, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        c, s = np.cos(quarter * np.pi / 2), np.sin(quarter * np.pi / 2)
        middle = np.array([sx * (x / 2 - radius), sy * (y / 2 - radius)])
        corners.append(arc @ np.array([[c, s], [-s, c]]) + middle)
    return np.concatenate(corners)
