# SPDX-License-Identifier: Apache-2.0
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
# The kind that a reconstruction reports for a simulated one: one of `types.CONTAINER_KINDS`.
RECONSTRUCTED_KIND = {"bin": "box", "tray": "box", "cylinder": "round", "bowl": "round",
                      "cup": "round", "bag": "free", "none": "none"}


@dataclass(frozen=True)
class ContainerShapeSettings:
    """Forms that the sizes of a container leave open; all chosen.

    Attributes:
        outline_corners: corners of a round outline.
        bowl_foot_ratio: radius of a bowl's flat floor over that of its rim.
        bowl_rings, bag_rings: outlines from floor to rim; the other kinds have two.
        bag_corner_ratio: radius of a bag's rounded corners over its smaller side.
        rounded_corner_points: corners of the outline in each rounded corner.
        fold_middle, fold_amplitude: share of its width by which a bag leans in at its floor, on
            average and by its folds.
        bag_taper: further share by which a bag is narrower at its floor.
        collision_wall_slope: metres by which collision walls grow outwards for each metre below
            the rim: thin walls let fast parts through.
        max_closing: largest share of the smaller side that the draft may take away.
    """

    outline_corners: int = 48
    bowl_foot_ratio: float = 0.35
    bowl_rings: int = 9
    bag_rings: int = 6
    bag_corner_ratio: float = 0.25
    rounded_corner_points: int = 12
    fold_middle: float = 0.06
    fold_amplitude: float = 0.06
    bag_taper: float = 0.10
    collision_wall_slope: float = 0.7
    max_closing: float = 0.8


SETTINGS = ContainerShapeSettings()


class ContainerError(StackCounterError):
    """A container of no use: an unknown kind, or sizes that leave no room inside."""


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
        seed: seed of a bag's folds.
    """

    kind: str
    T_world_container: np.ndarray = field(default_factory=lambda: np.eye(4))
    inner_size_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wall_thickness_m: float = 0.0
    floor_thickness_m: float = 0.0
    draft_rad: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        x, y, depth = self.inner_size_m
        if self.kind not in KINDS:
            raise ContainerError(f"container kind is '{self.kind}'; expected one of {KINDS}")
        smallest = min(x, y) if self.kind == "none" else min(
            *self.inner_size_m, self.wall_thickness_m, self.floor_thickness_m)
        if not (smallest > 0 and np.isfinite([*self.inner_size_m, self.wall_thickness_m,
                                              self.floor_thickness_m]).all()):
            raise ContainerError(f"{self.kind} measures {self.inner_size_m} m inside, walls "
                                 f"{self.wall_thickness_m} m; expected all above 0")
        if not 0 <= self.draft_rad < np.pi / 4:
            raise ContainerError(f"draft is {self.draft_rad} rad; expected 0 to pi / 4")
        if 2 * depth * np.tan(self.draft_rad) > SETTINGS.max_closing * min(x, y):
            raise ContainerError(f"{self.kind} of {self.inner_size_m} m with a draft of "
                                 f"{np.rad2deg(self.draft_rad):.0f} degrees closes at its floor")

    @property
    def rim_height_m(self) -> float:
        """Height of the rim above the support plane; 0 for a heap."""
        return self.floor_thickness_m + self.inner_size_m[2] if self.kind != "none" else 0.0

    @cached_property
    def inner_rings(self) -> np.ndarray:
        """Outlines of the inner wall, container frame, from floor to rim.

        (k, n, 3) float64, counter-clockwise, metres; for a heap the one outline of its region.
        """
        rim, depth = self._rim_outline(), self.inner_size_m[2]
        if self.kind == "none":
            return np.pad(rim, ((0, 0), (0, 1)))[None]
        count = {"bowl": SETTINGS.bowl_rings, "bag": SETTINGS.bag_rings}.get(self.kind, 2)
        rings = [np.column_stack([self._outline_at(rim, level), np.full(len(rim), level * depth)])
                 for level in np.linspace(0, 1, count)]
        return np.array(rings) + [0, 0, self.floor_thickness_m]

    def _rim_outline(self) -> np.ndarray:
        """(n, 2) outline of the rim opening, counter-clockwise, container frame, metres."""
        x, y, _ = self.inner_size_m
        if self.kind in ("bin", "tray", "none"):
            return np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2
        if self.kind == "bag":
            return _rounded_rectangle(x, y, SETTINGS.bag_corner_ratio * min(x, y))
        angle = 2 * np.pi * np.arange(SETTINGS.outline_corners) / SETTINGS.outline_corners
        return np.stack([x / 2 * np.cos(angle), y / 2 * np.sin(angle)], axis=1)

    def _outline_at(self, rim: np.ndarray, level: float) -> np.ndarray:
        """(n, 2) outline at a level: 0 at the floor, 1 at the rim."""
        down = 1 - level
        if self.kind == "bowl":
            return rim * np.sqrt(1 - (1 - SETTINGS.bowl_foot_ratio**2) * down**2)
        if self.kind == "bag":
            lean = down * self._fold_depths(rim)
            return rim * (1 - lean - SETTINGS.bag_taper * down**3)[:, None]
        return rim - _outward_offsets(rim) * (down * self.inner_size_m[2] * np.tan(self.draft_rad))

    def _fold_depths(self, rim: np.ndarray) -> np.ndarray:
        """(n,) shares by which a bag's wall leans in around the outline: 0 to 0.12."""
        random = np.random.default_rng([self.seed, 0xBA6])
        angle = np.arctan2(rim[:, 1], rim[:, 0])
        waves = sum(random.normal() * np.cos(k * angle + random.uniform(0, 2 * np.pi)) / k
                    for k in range(2, 7))
        return SETTINGS.fold_middle + SETTINGS.fold_amplitude * np.tanh(waves)

    @property
    def opening(self) -> np.ndarray:
        """(n, 2) outline of the rim opening, counter-clockwise, container frame, metres."""
        return self.inner_rings[-1][:, :2]

    def is_over_opening(self, points: np.ndarray) -> np.ndarray:
        """(...) bool: the points (..., 2 or 3) of the container frame lie over the opening."""
        x, y = np.asarray(points)[..., 0, None], np.asarray(points)[..., 1, None]
        (ax, ay), (bx, by) = self.opening.T, np.roll(self.opening, -1, axis=0).T
        # Inside is what a ray along x leaves through an odd number of sides.
        with np.errstate(divide="ignore", invalid="ignore"):
            crosses = ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
        return np.count_nonzero(crosses, axis=-1) % 2 == 1

    def mesh(self) -> Mesh | None:
        """The whole container in the world, closed; None for a heap."""
        if self.kind == "none":
            return None
        outer = self.inner_rings + _outward_moves(self.inner_rings, self.wall_thickness_m)
        foot = outer[:1] * [1, 1, 0]
        rings = np.concatenate([foot, outer, self.inner_rings[::-1]])
        return self._mesh_from_rings(rings, closed=True)

    def inner_mesh(self) -> Mesh | None:
        """Inner wall and floor in the world, seen from inside; None for a heap."""
        if self.kind == "none":
            return None
        return self._mesh_from_rings(self.inner_rings[::-1], closed=False)

    def _mesh_from_rings(self, rings: np.ndarray, closed: bool) -> Mesh:
        """Joins (k, n, 3) rings to a mesh.

        It ends at the middle of the last ring, and of the first one if closed.
        """
        k, n = rings.shape[:2]
        a, b = np.arange(n), np.roll(np.arange(n), -1)
        # Two triangles for each side of a ring and the same side of the next
        quads = [np.concatenate([np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)])
                 + i * n for i in range(k - 1)]
        # Fans from the middles of the end rings
        top = np.stack([a + (k - 1) * n, b + (k - 1) * n, np.full(n, k * n)], 1)
        bottom = [np.stack([b, a, np.full(n, k * n + 1)], 1)] if closed else []
        middles = [rings[-1].mean(axis=0), rings[0].mean(axis=0)][:1 + closed]
        vertices = geometry.apply(self.T_world_container,
                                  np.concatenate([rings.reshape(-1, 3), middles]))
        return Mesh(vertices.astype(np.float32),
                    np.concatenate([*quads, top, *bottom]).astype(np.int32))

    def collision_pieces(self) -> list[np.ndarray]:
        """Corners (8 or more, 3) of convex blocks in the container frame, metres.

        What the rays see, thickened outwards below the rim and the floor.
        """
        if self.kind == "none":
            return []
        rings = self.inner_rings
        depth = self.rim_height_m - rings[:, :, 2]
        thickness = self.wall_thickness_m + SETTINGS.collision_wall_slope * depth
        outer = rings + _outward_moves(rings, 1.0) * thickness[..., None]
        pieces = []
        for k in range(len(rings) - 1):
            loops = np.stack([rings[k], rings[k + 1], outer[k], outer[k + 1]])  # (4, n, 3)
            pieces += list(np.concatenate([loops, np.roll(loops, -1, axis=1)]).transpose(1, 0, 2))
        below = outer[0] * [1, 1, 0] - [0, 0, self.inner_size_m[2]]
        return pieces + [np.concatenate([rings[0], below])]


def _outward_offsets(outline: np.ndarray) -> np.ndarray:
    """(n, 2) moves of the corners of an (n, 2) outline when every side moves out by one."""
    side = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([side[:, 1], -side[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    previous = np.roll(normal, 1, axis=0)
    return (normal + previous) / (1 + np.sum(normal * previous, axis=1, keepdims=True))


def polygon_area(outlines: np.ndarray) -> np.ndarray:
    """(...) areas of counter-clockwise outlines (..., n, 2), in the square of their unit."""
    x, y = np.moveaxis(outlines, -1, 0)
    next_x, next_y = np.roll(x, -1, axis=-1), np.roll(y, -1, axis=-1)
    return np.sum(x * next_y - next_x * y, axis=-1) / 2


def _outward_moves(rings: np.ndarray, distance: float) -> np.ndarray:
    """(k, n, 3) horizontal outward moves of all rings' corners."""
    flat = [np.pad(_outward_offsets(ring[:, :2]), ((0, 0), (0, 1))) for ring in rings]
    return np.stack(flat) * distance


def _rounded_rectangle(x: float, y: float, radius: float) -> np.ndarray:
    """(4 * rounded_corner_points, 2) counter-clockwise outline of sides x and y."""
    angle = np.linspace(0, np.pi / 2, SETTINGS.rounded_corner_points)
    arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corners = []
    for quarter, (sign_x, sign_y) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        c, s = np.cos(quarter * np.pi / 2), np.sin(quarter * np.pi / 2)
        middle = np.array([sign_x * (x / 2 - radius), sign_y * (y / 2 - radius)])
        corners.append(arc @ np.array([[c, s], [-s, c]]) + middle)
    return np.concatenate(corners)
