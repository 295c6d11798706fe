"""Finds a taught container in a scan: only its pose is unknown."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import TaughtContainer
from stack_counter.container.detection import MIN_RIM, from_wall, rim_map
from stack_counter.container.rim import rim_height, rim_points, rim_share
from stack_counter.container.wall_fit import FacePoints, face_points, fit_outline, fit_wall
from stack_counter.container.wall_shapes import WallShape, rotation_2d
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.tsdf import FusedSurface
from stack_counter.types import Container, HeightMap, View

_TURNS = 72  # of the outline that are tried against the rim
_REFINED = 8  # of them, each better than its neighbours
_ALIKE = 0.05  # share of the rim by which one of these must be worse to be out
_FAR = 0.003  # from a face, where points show another thing, m
_KNOWN = 1e-6  # standard deviation of a thickness that is known, m


@dataclass(frozen=True)
class PlacedWall:
    """A form of fixed shape somewhere in the world; its parameters are x, y (m) and yaw (rad)."""

    form: WallShape
    params: np.ndarray

    @property
    def kind(self) -> str:
        """See `WallForm`."""
        return self.form.kind

    @property
    def params_std(self) -> np.ndarray:
        """See `WallForm`."""
        return np.array([0.003, 0.003, 0.02])

    def with_params(self, params: np.ndarray) -> PlacedWall:
        """See `WallForm`."""
        return PlacedWall(self.form, params)

    @property
    def pose(self) -> tuple[np.ndarray, float]:
        """See `WallForm`."""
        return self.params[:2], float(self.params[2])

    def depth_inside(self, xy: np.ndarray, below: np.ndarray) -> np.ndarray:
        """See `WallForm`."""
        return self.form.depth_inside(self._local(xy), below)

    def outward(self, xy: np.ndarray) -> np.ndarray:
        """See `WallForm`."""
        return self.form.outward(self._local(xy)) @ rotation_2d(self.params[2]).T

    def ring(self, below: float, inwards: float) -> np.ndarray:
        """See `WallForm`."""
        return self.form.ring(below, inwards) @ rotation_2d(self.params[2]).T + self.params[:2]

    def moved(self, inwards: float) -> PlacedWall:
        """See `WallForm`."""
        return PlacedWall(self.form.moved(inwards), self.params)

    def centred(self) -> WallShape:
        """See `WallForm`."""
        return self.form

    def _local(self, xy: np.ndarray) -> np.ndarray:
        return (xy - self.params[:2]) @ rotation_2d(self.params[2])


def place_container(taught: TaughtContainer, view: FusedSurface, views: list[View], region: Region,
                    voxel_size: float, config: ReconstructorConfig) -> Container:
    """The taught container where it stands in this scan.

    Args:
        taught: its form and sizes.
        view: the fused surface.
        views: that it was fused from.
        region: where to look. The support plane is taken to lie where the rim's height says, as
            that is how the floor below the stack stands to the surface above it.
        voxel_size: metres.
        config: says where the pose comes from.

    Raises:
        ScanError: no rim of that outline at that height.
    """
    top = rim_map(view, region, voxel_size)
    given = config.container_pose == "given"
    forms = [PlacedWall(taught.form, np.array(config.container_xyyaw))] if given \
        else _on_rim(taught, top, region.lowest, config.container)
    higher = rim_height(top, forms[0], taught.wall_m, taught.rim_m) - taught.rim_m
    region = replace(region, plane_z=region.plane_z + higher)
    form = forms[0]
    if not given:
        points = face_points(views, region, form, taught.rim_m)
        form = min(forms, key=lambda f: _miss(f, points, taught.wall_m))
        fitted = fit_wall(form, points, taught.rim_m, taught.wall_m, _KNOWN, region.noise).form
        form = form.with_params(fitted.params)
    return from_wall(form, taught.wall_m, taught.rim_m, taught.floor_m, region.plane_z)


def _on_rim(taught: TaughtContainer, top: HeightMap, lowest: float, name: str) -> list[PlacedWall]:
    """The form in all the ways in which its outline meets the rim; an outline with symmetries
    does in several."""
    points, middle, _ = rim_points(top, lowest, taught.rim_m)
    level, scale = np.zeros(len(points)), max(top.pitch, 0.0015) / 2
    turns = [PlacedWall(taught.form, np.append(middle, yaw))
             for yaw in 2 * np.pi * np.arange(_TURNS) / _TURNS]
    # The logarithm: what hangs over the rim is far off.
    miss = np.array([np.log1p(np.abs(form.depth_inside(points, level)) / scale).sum()
                     for form in turns])
    best = np.nonzero((miss <= np.roll(miss, 1)) & (miss <= np.roll(miss, -1)))[0]
    chosen = best[np.argsort(miss[best], kind="stable")[:_REFINED]]
    forms = [turns[i].with_params(fit_outline(turns[i], points, scale).params) for i in chosen]
    shares = [rim_share(form, points, top.pitch) for form in forms]
    if max(shares) < MIN_RIM:
        raise ScanError(f"container '{name}' not found: a rim {taught.rim_m:.3f} m high on "
                        f"{max(shares):.0%} of its outline; expected {MIN_RIM:.0%}")
    return [form for form, share in zip(forms, shares) if share > max(shares) - _ALIKE]


def _miss(form: PlacedWall, points: FacePoints, wall: float) -> float:
    """Mean distance of points from the face they were seen on, metres; robust."""
    away = form.depth_inside(points.xy, points.below) - wall * points.inner
    return float(np.minimum(np.abs(away), _FAR).mean())
