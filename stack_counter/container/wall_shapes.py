"""Forms of a container's wall: rectangular with draft, round, or free-form.

A form says how far inside the wall's outer face a point lies, as a smooth function of a few
parameters (`walls.py` fits them), and draws the wall's outline at any depth below the rim.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

_WAVES = 8  # Fourier orders of a free-form outline
_LEANS = 4  # and of its lean
_ROUND_SIDES = 96  # corners of a round or free-form ring


class WallShape(Protocol):
    """What all forms can do."""

    @property
    def kind(self) -> str:
        """One of `types.CONTAINER_KINDS`."""
        ...

    @property
    def params(self) -> np.ndarray:
        """(m,) parameters."""
        ...

    @property
    def params_std(self) -> np.ndarray:
        """(m,) how far they are expected to be from a first guess."""
        ...

    def with_params(self, params: np.ndarray) -> WallShape:
        """The same form with other parameters."""
        ...

    @property
    def pose(self) -> tuple[np.ndarray, float]:
        """Middle, (2,) metres in the world, and yaw, rad."""
        ...

    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        """(n,) metres that (n, 2) world points lie inside the outer face, `below` ((n,) metres)
        the rim; negative outside."""
        ...

    def outward(self, xy: np.ndarray) -> np.ndarray:
        """(n, 2) horizontal unit normals of the wall nearest to (n, 2) world points."""
        ...

    def ring(self, below: float, inwards: float) -> np.ndarray:
        """(k, 2) counter-clockwise world outline at a depth, moved inwards by so much, metres."""
        ...

    def moved(self, inwards: float) -> WallShape:
        """The form with its whole face moved inwards by so many metres."""
        ...

    def centred(self) -> WallShape:
        """The form in the container's own frame: its middle at 0, its yaw 0."""
        ...


@dataclass(frozen=True)
class BoxWall:
    """Parameters: centre x, y (m, world), yaw (rad), outer size x, y at the rim (m), and by how
    much the walls come in for each metre down (tangent of the draft)."""

    params: np.ndarray
    kind: ClassVar[str] = "box"

    def with_params(self, params: np.ndarray) -> BoxWall:
        """See `WallForm`."""
        return BoxWall(params)

    @property
    def params_std(self) -> np.ndarray:
        """See `WallForm`."""
        return np.array([0.003, 0.003, 0.02, 0.004, 0.004, 0.15])

    @property
    def pose(self) -> tuple[np.ndarray, float]:
        """See `WallForm`."""
        return self.params[:2], float(self.params[2])

    def _beside(self, xy: np.ndarray) -> np.ndarray:
        """(n, 4) distances inwards from the rim's sides -x, +x, -y, +y."""
        x, y = ((xy - self.params[:2]) @ rotation_2d(self.params[2])).T
        a, b = self.params[3:5] / 2
        return np.stack([a + x, a - x, b + y, b - y], axis=1)

    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        """See `WallForm`."""
        return self._beside(xy).min(axis=1) - self.params[5] * below

    def outward(self, xy: np.ndarray) -> np.ndarray:
        """See `WallForm`."""
        normals = np.array([[-1.0, 0], [1, 0], [0, -1], [0, 1]]) @ rotation_2d(self.params[2]).T
        return normals[self._beside(xy).argmin(axis=1)]

    def ring(self, below: float, inwards: float) -> np.ndarray:
        """See `WallForm`."""
        a, b = np.maximum(self.params[3:5] / 2 - inwards - self.params[5] * below, 1e-4)
        corners = np.array([[-a, -b], [a, -b], [a, b], [-a, b]])
        return corners @ rotation_2d(self.params[2]).T + self.params[:2]

    def moved(self, inwards: float) -> BoxWall:
        """See `WallForm`."""
        return BoxWall(self.params - inwards * np.array([0, 0, 0, 2, 2, 0]))

    def centred(self) -> BoxWall:
        """See `WallForm`."""
        return BoxWall(np.concatenate([np.zeros(3), self.params[3:]]))


@dataclass(frozen=True)
class RoundWall:
    """A body of revolution whose profile is a conic: cylinder, cone, ball, ellipsoid.

    Parameters: centre x, y (m, world), radius R at the rim (m), p and q in
    r^2 = R^2 - 2 p R below - q below^2.
    """

    params: np.ndarray
    kind: ClassVar[str] = "round"

    def with_params(self, params: np.ndarray) -> RoundWall:
        """See `WallForm`."""
        return RoundWall(params)

    @property
    def params_std(self) -> np.ndarray:
        """See `WallForm`."""
        return np.array([0.003, 0.003, 0.003, 0.2, 1.0])

    @property
    def pose(self) -> tuple[np.ndarray, float]:
        """See `WallForm`."""
        return self.params[:2], 0.0

    def _radius(self, below: np.ndarray | float) -> np.ndarray:
        _, _, R, p, q = self.params
        return np.sqrt(np.maximum(R**2 - 2 * p * R * below - q * np.square(below), (0.1 * R)**2))

    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        """See `WallForm`."""
        return self._radius(below) - np.linalg.norm(xy - self.params[:2], axis=1)

    def outward(self, xy: np.ndarray) -> np.ndarray:
        """See `WallForm`."""
        away = xy - self.params[:2]
        return away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)

    def ring(self, below: float, inwards: float) -> np.ndarray:
        """See `WallForm`; a polygon with the circle's area."""
        angle = 2 * np.pi * np.arange(_ROUND_SIDES) / _ROUND_SIDES
        r = np.maximum(self._radius(below) - inwards, 0.05 * self.params[2])
        r *= np.sqrt(angle[1] / np.sin(angle[1]))
        return self.params[:2] + r * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def moved(self, inwards: float) -> RoundWall:
        """See `WallForm`."""
        return RoundWall(self.params - inwards * np.array([0, 0, 1, 0, 0]))

    def centred(self) -> RoundWall:
        """See `WallForm`."""
        return RoundWall(np.concatenate([np.zeros(2), self.params[2:]]))


def fourier(angle: np.ndarray, orders: int) -> np.ndarray:
    """(n, 2 orders + 1) columns 1, cos and sin of the multiples of an angle."""
    k = np.arange(1, orders + 1) * angle[:, None]
    return np.concatenate([np.ones((len(angle), 1)), np.cos(k), np.sin(k)], axis=1)


_ANGLES = np.linspace(-np.pi, np.pi, 361)
_RIM_WAVES, _LEAN_WAVES = fourier(_ANGLES, _WAVES), fourier(_ANGLES, _LEANS)


@dataclass(frozen=True)
class FreeWall:
    """Any star-shaped outline that leans in by any amount that changes slowly around it.

    Parameters: Fourier coefficients of the outer radius at the rim (m) around `center`, then of
    the lean (m inwards for each metre down), then the wall's common bend (1).
    """

    params: np.ndarray
    center: np.ndarray
    kind: ClassVar[str] = "free"

    def with_params(self, params: np.ndarray) -> FreeWall:
        """See `WallForm`."""
        return FreeWall(params, self.center)

    @property
    def params_std(self) -> np.ndarray:
        """See `WallForm`."""
        return np.concatenate([np.full(2 * _WAVES + 1, 0.003), np.full(2 * _LEANS + 1, 0.15),
                               [0.3]])

    @property
    def pose(self) -> tuple[np.ndarray, float]:
        """See `WallForm`."""
        return self.center, 0.0

    @property
    def _tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rim's radius, lean, and cosine between radius and normal, at the angles `_ANGLES`."""
        m = 2 * _WAVES + 1
        rim, lean = _RIM_WAVES @ self.params[:m], _LEAN_WAVES @ self.params[m:-1]
        slope = np.gradient(rim, _ANGLES)
        return rim, lean, rim / np.hypot(rim, slope)

    def _radius(self, rim: np.ndarray, lean: np.ndarray, below: np.ndarray | float) -> np.ndarray:
        return rim - lean * below - self.params[-1] * np.square(below) / self.params[0]

    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        """See `WallForm`."""
        away = xy - self.center
        angle = np.arctan2(away[:, 1], away[:, 0])
        rim, lean, slant = (np.interp(angle, _ANGLES, table) for table in self._tables)
        return (self._radius(rim, lean, below) - np.linalg.norm(away, axis=1)) * slant

    def outward(self, xy: np.ndarray) -> np.ndarray:
        """See `WallForm`; along the radius."""
        away = xy - self.center
        return away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)

    def ring(self, below: float, inwards: float) -> np.ndarray:
        """See `WallForm`."""
        angle = _ANGLES[:-1:4]
        rim, lean, slant = (table[:-1:4] for table in self._tables)
        r = np.maximum(self._radius(rim, lean, below) - inwards / slant, 0.05 * self.params[0])
        return self.center + r[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def moved(self, inwards: float) -> FreeWall:
        """See `WallForm`; along the radius."""
        return FreeWall(self.params - inwards * np.eye(len(self.params))[0], self.center)

    def centred(self) -> FreeWall:
        """See `WallForm`."""
        return FreeWall(self.params, np.zeros(2))


def rotation_2d(yaw: float) -> np.ndarray:
    """(2, 2) rotation of the plane."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])
