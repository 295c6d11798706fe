# SPDX-License-Identifier: Apache-2.0
"""Containers, height maps and meshes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

# free: any open container with a level rim; hull: only an outline is known, no inner surface.
CONTAINER_KINDS = ("box", "round", "free", "none", "hull")


@dataclass(frozen=True, eq=False)
class WallShape(ABC):
    """The outer face of a container's wall as a smooth function of a few parameters.

    Attributes:
        params: (m,) float64; the subclass says what each is.
    """

    params: np.ndarray

    @property
    @abstractmethod
    def kind(self) -> str:
        """One of `CONTAINER_KINDS`."""

    @property
    @abstractmethod
    def prior_std(self) -> np.ndarray:
        """(m,) standard deviations of the parameters around a first guess."""

    @property
    @abstractmethod
    def center(self) -> np.ndarray:
        """(2,) metres, the wall's middle in the world."""

    @property
    @abstractmethod
    def yaw(self) -> float:
        """Angle from the world's x to the wall's own, rad."""

    def with_params(self, params: np.ndarray) -> Self:
        """The same kind of shape with other parameters (m,)."""
        return replace(self, params=params)

    @abstractmethod
    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        """Distance by which points lie inside the outer face; negative outside.

        (n,) metres for (n, 2) world points, `below` ((n,) metres) the rim.
        """

    @abstractmethod
    def outward_normals(self, xy: np.ndarray) -> np.ndarray:
        """(n, 2) horizontal unit normals of the wall nearest to (n, 2) world points."""

    @abstractmethod
    def ring(self, below: float, inwards: float) -> np.ndarray:
        """(k, 2) counter-clockwise outline, world, metres.

        Args:
            below: depth below the rim, metres.
            inwards: distance from the outer face, metres.
        """

    @abstractmethod
    def offset_inwards(self, inwards: float) -> WallShape:
        """The shape with its whole face moved inwards by so many metres."""

    @abstractmethod
    def in_own_frame(self) -> WallShape:
        """The shape in the container's own frame: its middle at 0, its yaw 0."""


@dataclass(frozen=True, eq=False)
class InnerMap:
    """A container's inner surface as seen from straight above, known from its CAD file.

    Attributes:
        pitch: side of a cell, metres.
        heights: (rows, cols) float32, metres above the support plane; the container's origin lies
            in the middle of the map, its x along the columns; NaN outside the opening.
    """

    pitch: float
    heights: np.ndarray


@dataclass(frozen=True, eq=False)
class Container:
    """What holds the parts.

    Attributes:
        kind: one of `CONTAINER_KINDS`.
        T_world_container: (4, 4) float64; origin at the centre of the bottom, on the support
            plane; z up; x along the first inner side.
        inner_size_m: x and y of the rim opening, and height from inner floor to rim, metres;
            zeros for `none`.
        wall_thickness_m, floor_thickness_m: metres; the wall's is measured horizontally.
        rings: (k, n, 3) counter-clockwise outlines of the inner wall, container frame, metres,
            from the support plane (below the floor) to the rim; None for `none` and `hull`, and
            in a container that came by message.
        wall_shape: outer face of the wall, container frame; None as for `rings`.
        inner_map: inner surface with its ledges and ribs, where a CAD file says it; else None,
            and the inner surface is the rings' and a level floor.
    """

    kind: str
    T_world_container: np.ndarray
    inner_size_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wall_thickness_m: float = 0.0
    floor_thickness_m: float = 0.0
    rings: np.ndarray | None = None
    wall_shape: WallShape | None = None
    inner_map: InnerMap | None = None

    @property
    def outer_size_m(self) -> tuple[float, float, float]:
        """x and y at the rim, and from the support plane up to the rim, metres."""
        (x, y, depth), wall = self.inner_size_m, 2 * self.wall_thickness_m
        if not any(self.inner_size_m):
            return (0.0, 0.0, 0.0)
        return (x + wall, y + wall, depth + self.floor_thickness_m)


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights over a regular grid.

    Attributes:
        T_world_map: (4, 4) float64; cell (row, col) covers x in [col, col + 1) * pitch and
            y in [row, row + 1) * pitch of the map frame, z up, z = 0 on the support plane.
        pitch: side of a cell, metres.
        heights: (rows, cols) float32, metres along map z; NaN where not valid.
    """

    T_world_map: np.ndarray
    pitch: float
    heights: np.ndarray


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: vertices (n, 3) float32 metres, world.

    Triangles (m, 3) int32; colours (n, 3) uint8 RGB or None.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray | None = None
