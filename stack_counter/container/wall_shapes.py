# SPDX-License-Identifier: Apache-2.0
"""Shapes of a container's wall: rectangular with draft, round, or free-form (`types.WallShape`).

Each tells how far inside the wall's outer face a point lies, as a smooth function of a few
parameters (`wall_fit.py` fits them), and gives the wall's outline at any depth below the rim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from stack_counter.types import WallShape


@dataclass(frozen=True)
class WallShapeSettings:
    """What all shapes share, and how far fits may take them from a first guess.

    Attributes:
        radius_orders: Fourier orders of a free-form outline; chosen.
        lean_orders: Fourier orders of a free-form wall's lean; chosen, an outline turns faster
            around the container than its lean.
        ring_corners: corners of a round ring; chosen, a multiple of 4.
        angle_samples: directions in which a free-form outline is tabulated, the first one twice;
            chosen, one for each degree.
        samples_per_corner: tabulated directions for each corner of a free-form ring; chosen.
        place_std: standard deviation of a place or an outer radius, m; chosen.
        yaw_std: standard deviation of a box's yaw, rad; chosen.
        side_std: standard deviation of a box's outer sides, m; chosen.
        draft_std: standard deviation of a box's draft and a free-form wall's lean, m/m; chosen.
        round_lean_std: standard deviation of a round wall's p, m/m; chosen.
        round_bend_std: standard deviation of a round wall's q, m2/m2; chosen.
        free_bend_std: standard deviation of a free-form wall's bend, m/m; chosen.
        narrowest_share: least radius of a round wall's face, over that at the rim; chosen.
        narrowest_ring_share: least radius of a ring, over that at the rim; chosen.
        narrowest_half_side: least half side of a box's ring, m; chosen.
    """

    radius_orders: int = 8
    lean_orders: int = 4
    ring_corners: int = 96
    angle_samples: int = 361
    samples_per_corner: int = 4
    place_std: float = 0.003
    yaw_std: float = 0.02
    side_std: float = 0.004
    draft_std: float = 0.15
    round_lean_std: float = 0.2
    round_bend_std: float = 1.0
    free_bend_std: float = 0.3
    narrowest_share: float = 0.1
    narrowest_ring_share: float = 0.05
    narrowest_half_side: float = 1e-4


SETTINGS = WallShapeSettings()


def rotation_2d(yaw: float) -> np.ndarray:
    """(2, 2) rotation of the plane by an angle, rad."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def fourier_basis(angle: np.ndarray, orders: int) -> np.ndarray:
    """(n, 2 orders + 1) columns 1, cos and sin of the multiples of (n,) angles, rad."""
    k = np.arange(1, orders + 1) * angle[:, None]
    return np.concatenate([np.ones((len(angle), 1)), np.cos(k), np.sin(k)], axis=1)


@dataclass(frozen=True, eq=False)
class BoxWall(WallShape):
    """A rectangle whose walls lean in by the same draft on all sides, or by a known one on each.

    Attributes:
        params: (6,) centre x, y (m, world), yaw (rad), outer size x, y at the rim (m), and by how
            much the walls come in for each metre down (tangent of the draft).
        extra_draft_y: by how much more than that the walls at the ends of y come in, m/m; not
            fitted.
    """

    extra_draft_y: float = 0.0
    kind = "box"

    @property
    @override
    def prior_std(self) -> np.ndarray:
        s = SETTINGS
        return np.array([s.place_std, s.place_std, s.yaw_std, s.side_std, s.side_std,
                         s.draft_std])

    @property
    @override
    def center(self) -> np.ndarray:
        return self.params[:2]

    @property
    @override
    def yaw(self) -> float:
        return float(self.params[2])

    def _in_own_axes(self, xy: np.ndarray) -> np.ndarray:
        """(2, n) x and y of points along the rim's sides, from its middle, metres."""
        return ((xy - self.params[:2]) @ rotation_2d(self.params[2])).T

    @override
    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        (x, y), (a, b), drafts = self._in_own_axes(xy), self.params[3:5] / 2, self._drafts()
        return np.minimum(a - np.abs(x) - drafts[0] * below, b - np.abs(y) - drafts[1] * below)

    @override
    def outward_normals(self, xy: np.ndarray) -> np.ndarray:
        (x, y), (a, b) = self._in_own_axes(xy), self.params[3:5] / 2
        beside_x = a - np.abs(x) <= b - np.abs(y)
        normals = np.array([[-1.0, 0], [1, 0], [0, -1], [0, 1]]) @ rotation_2d(self.params[2]).T
        return normals[np.where(beside_x, x > 0, 2 + (y > 0))]

    @override
    def ring(self, below: float, inwards: float) -> np.ndarray:
        a, b = np.maximum(self.params[3:5] / 2 - inwards - self._drafts() * below,
                          SETTINGS.narrowest_half_side)
        corners = np.array([[-a, -b], [a, -b], [a, b], [-a, b]])
        return corners @ rotation_2d(self.params[2]).T + self.params[:2]

    @override
    def offset_inwards(self, inwards: float) -> BoxWall:
        return self.with_params(self.params - inwards * np.array([0, 0, 0, 2, 2, 0]))

    @override
    def in_own_frame(self) -> BoxWall:
        return self.with_params(np.concatenate([np.zeros(3), self.params[3:]]))

    def _drafts(self) -> np.ndarray:
        """(2,) drafts of the walls at the ends of x and of y, m/m."""
        return self.params[5] + np.array([0.0, self.extra_draft_y])


@dataclass(frozen=True, eq=False)
class RoundWall(WallShape):
    """A body of revolution whose profile is a conic: cylinder, cone, ball, ellipsoid.

    Attributes:
        params: (5,) centre x, y (m, world), radius R at the rim (m), p and q in
            r^2 = R^2 - 2 p R below - q below^2.
    """

    kind = "round"

    @property
    @override
    def prior_std(self) -> np.ndarray:
        s = SETTINGS
        return np.array([s.place_std, s.place_std, s.place_std, s.round_lean_std,
                         s.round_bend_std])

    @property
    @override
    def center(self) -> np.ndarray:
        return self.params[:2]

    @property
    @override
    def yaw(self) -> float:
        return 0.0

    def _radius(self, below: np.ndarray | float) -> np.ndarray:
        """Outer radius, metres, so many metres below the rim."""
        _, _, R, p, q = self.params
        return np.sqrt(np.maximum(R**2 - 2 * p * R * below - q * np.square(below),
                                  (SETTINGS.narrowest_share * R)**2))

    @override
    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        return self._radius(below) - np.linalg.norm(xy - self.params[:2], axis=1)

    @override
    def outward_normals(self, xy: np.ndarray) -> np.ndarray:
        return _unit_vectors(xy - self.params[:2])

    @override
    def ring(self, below: float, inwards: float) -> np.ndarray:
        """A polygon with the circle's area; see `WallShape.ring`."""
        angle = 2 * np.pi * np.arange(SETTINGS.ring_corners) / SETTINGS.ring_corners
        r = np.maximum(self._radius(below) - inwards,
                       SETTINGS.narrowest_ring_share * self.params[2])
        r *= np.sqrt(angle[1] / np.sin(angle[1]))
        return self.params[:2] + r * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    @override
    def offset_inwards(self, inwards: float) -> RoundWall:
        return RoundWall(self.params - inwards * np.array([0, 0, 1, 0, 0]))

    @override
    def in_own_frame(self) -> RoundWall:
        return RoundWall(np.concatenate([np.zeros(2), self.params[2:]]))


_RADIUS_COEFFICIENTS = 2 * SETTINGS.radius_orders + 1
_LEAN_COEFFICIENTS = 2 * SETTINGS.lean_orders + 1
_ANGLES = np.linspace(-np.pi, np.pi, SETTINGS.angle_samples)
_RADIUS_BASIS = fourier_basis(_ANGLES, SETTINGS.radius_orders)
_LEAN_BASIS = fourier_basis(_ANGLES, SETTINGS.lean_orders)


@dataclass(frozen=True, eq=False)
class FreeWall(WallShape):
    """Any star-shaped outline that leans in by any amount that changes slowly around it.

    Attributes:
        params: (27,) Fourier coefficients (mean, cosines, sines) of the outer radius at the rim
            around `origin` (17, m), then of the lean (9, m inwards for each metre down), then the
            wall's common bend (1, m/m).
        origin: (2,) metres, world, from where radii are measured.
    """

    origin: np.ndarray
    kind = "free"

    @classmethod
    def from_outline(cls, center: np.ndarray, radii: np.ndarray) -> FreeWall:
        """The upright wall with a given rim.

        Args:
            center: (2,) metres, world.
            radii: (17,) Fourier coefficients of the rim's radius around it, metres.
        """
        return cls(np.concatenate([radii, np.zeros(_LEAN_COEFFICIENTS + 1)]), center)

    @property
    @override
    def prior_std(self) -> np.ndarray:
        s = SETTINGS
        return np.concatenate([np.full(_RADIUS_COEFFICIENTS, s.place_std),
                               np.full(_LEAN_COEFFICIENTS, s.draft_std), [s.free_bend_std]])

    @property
    @override
    def center(self) -> np.ndarray:
        return self.origin

    @property
    @override
    def yaw(self) -> float:
        return 0.0

    def _tabulate(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rim's radius, lean, and cosine between radius and normal, at the angles `_ANGLES`."""
        radius = _RADIUS_BASIS @ self.params[:_RADIUS_COEFFICIENTS]
        lean = _LEAN_BASIS @ self.params[_RADIUS_COEFFICIENTS:-1]
        slope = np.gradient(radius, _ANGLES)
        return radius, lean, radius / np.hypot(radius, slope)

    def _radius(self, rim: np.ndarray, lean: np.ndarray, below: np.ndarray | float) -> np.ndarray:
        """(n,) outer radii, metres, so many metres below a rim of these radii and leans."""
        return rim - lean * below - self.params[-1] * np.square(below) / self.params[0]

    @override
    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        offsets = xy - self.origin
        angle = np.arctan2(offsets[:, 1], offsets[:, 0])
        rim, lean, cosine = (np.interp(angle, _ANGLES, table) for table in self._tabulate())
        return (self._radius(rim, lean, below) - np.linalg.norm(offsets, axis=1)) * cosine

    @override
    def outward_normals(self, xy: np.ndarray) -> np.ndarray:
        """Directions along the radius, which is near the normal; see `WallShape`."""
        return _unit_vectors(xy - self.origin)

    @override
    def ring(self, below: float, inwards: float) -> np.ndarray:
        corners = slice(None, -1, SETTINGS.samples_per_corner)
        rim, lean, cosine = (table[corners] for table in self._tabulate())
        angle = _ANGLES[corners]
        r = np.maximum(self._radius(rim, lean, below) - inwards / cosine,
                       SETTINGS.narrowest_ring_share * self.params[0])
        return self.origin + r[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    @override
    def offset_inwards(self, inwards: float) -> FreeWall:
        """The shape with all radii shortened by so much; see `WallShape`."""
        return FreeWall(self.params - inwards * np.eye(len(self.params))[0], self.origin)

    @override
    def in_own_frame(self) -> FreeWall:
        return FreeWall(self.params, np.zeros(2))


def _unit_vectors(offsets: np.ndarray) -> np.ndarray:
    """(n, 2) directions of vectors; zero for those without length."""
    return offsets / np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-9)
