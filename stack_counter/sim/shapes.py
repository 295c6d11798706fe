"""Random parts: watertight single solids of families that cells handle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold

from stack_counter.errors import StackCounterError

_SIDES = 32  # segments of a circle


class ShapeError(StackCounterError):
    """A solid is not one watertight body, or of no volume."""


@dataclass(frozen=True)
class Shape:
    """One part.

    Attributes:
        family: name of the generator.
        vertices: (n, 3) float64, metres, centre of mass at the origin.
        faces: (m, 3) int32, counter-clockwise from outside.
    """

    family: str
    vertices: np.ndarray
    faces: np.ndarray

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The part as a mesh, metres."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    @property
    def unit_volume(self) -> float:
        """v of the mesh as stored, m3."""
        return float(self.mesh.volume)

    @property
    def part_size(self) -> float:
        """Largest side of the bounding box, metres."""
        return float(np.ptp(self.vertices, axis=0).max())

    @property
    def convexity(self) -> float:
        """V / V_hull."""
        return self.unit_volume / float(self.mesh.convex_hull.volume)


def _cylinder(height: float, radius: float, sides: int = _SIDES) -> Manifold:
    return Manifold.cylinder(height, radius, radius, sides, True)


def _block(r: np.random.Generator) -> Manifold:
    return Manifold.cube([1, r.uniform(0.5, 1), r.uniform(0.4, 1)], True)


def _plate(r: np.random.Generator) -> Manifold:
    return Manifold.cube([1, r.uniform(0.5, 1), r.uniform(0.06, 0.2)], True)


def _rod(r: np.random.Generator) -> Manifold:
    return _cylinder(1, r.uniform(0.06, 0.2), int(r.choice([6, _SIDES])))


def _tube(r: np.random.Generator) -> Manifold:
    outer = r.uniform(0.15, 0.5)
    return _cylinder(1, outer) - _cylinder(2, outer * r.uniform(0.5, 0.88))


def _ring(r: np.random.Generator) -> Manifold:
    thin = r.uniform(0.07, 0.17)
    return CrossSection.circle(thin, 16).translate([0.5 - thin, 0]).revolve(_SIDES)


def _nut(r: np.random.Generator) -> Manifold:
    height = r.uniform(0.35, 0.8)
    return _cylinder(height, 0.5, 6) - _cylinder(2, 0.5 * r.uniform(0.45, 0.68))


def _pin(r: np.random.Generator) -> Manifold:
    head = r.uniform(0.12, 0.3)
    radius = r.uniform(0.2, 0.4)
    shank = _cylinder(1 - head, radius * r.uniform(0.35, 0.65)).translate([0, 0, head / 2])
    return shank + _cylinder(head * 1.01, radius, int(r.choice([6, _SIDES]))).translate(
        [0, 0, (head - 1) / 2])


def _bracket(r: np.random.Generator) -> Manifold:
    arm, thick = r.uniform(0.5, 1), r.uniform(0.08, 0.25)
    profile = CrossSection([[[0, 0], [1, 0], [1, thick], [thick, thick], [thick, arm], [0, arm]]])
    return profile.extrude(r.uniform(0.3, 0.9))


def _elbow(r: np.random.Generator) -> Manifold:
    thin = r.uniform(0.1, 0.2)
    hollow = r.uniform(0, 0.8)
    profile = CrossSection.circle(thin, 24)
    if hollow > 0.4:
        profile = profile - CrossSection.circle(thin * hollow, 24)
    return profile.translate([r.uniform(0.35, 0.6), 0]).revolve(_SIDES, r.uniform(80, 150))


def _capsule(r: np.random.Generator) -> Manifold:
    radius = r.uniform(0.15, 0.35)
    ball = Manifold.sphere(radius, 24)
    return Manifold.batch_hull([ball.translate([0, 0, 0.5 - radius]),
                                ball.translate([0, 0, radius - 0.5])])


def _ellipsoid(r: np.random.Generator) -> Manifold:
    return Manifold.sphere(0.5, _SIDES).scale([1, r.uniform(0.5, 1), r.uniform(0.4, 1)])


def _cup(r: np.random.Generator) -> Manifold:
    height, wall = r.uniform(0.5, 1), r.uniform(0.05, 0.14)
    draft = r.uniform(0.7, 1)
    outer = Manifold.cylinder(height, 0.5 * draft, 0.5, _SIDES)
    inner = Manifold.cylinder(height, 0.5 * draft - wall, 0.5 - wall, _SIDES)
    return outer - inner.translate([0, 0, wall])


def _star(r: np.random.Generator) -> Manifold:
    points, inner = int(r.integers(4, 9)), r.uniform(0.4, 0.75)
    angle = np.arange(2 * points) * np.pi / points
    radius = np.where(np.arange(2 * points) % 2, 0.5 * inner, 0.5)
    outline = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return CrossSection([outline]).extrude(r.uniform(0.1, 0.5))


def _gear(r: np.random.Generator) -> Manifold:
    teeth = int(r.integers(8, 18))
    wheel = CrossSection.circle(0.42, _SIDES)
    tooth = CrossSection.square([0.16, 0.5 / teeth * np.pi * 0.7], True).translate([0.42, 0])
    profile = CrossSection.batch_boolean(
        [wheel] + [tooth.rotate(360 * i / teeth) for i in range(teeth)], manifold3d.OpType.Add)
    bore = CrossSection.circle(r.uniform(0.08, 0.25), _SIDES)
    return (profile - bore).extrude(r.uniform(0.12, 0.4))


def _ribbon(r: np.random.Generator) -> Manifold:
    profile = CrossSection.square([r.uniform(0.25, 0.45), r.uniform(0.06, 0.12)], True)
    return profile.extrude(1, 24, r.uniform(180, 540))


def _wedge(r: np.random.Generator) -> Manifold:
    return CrossSection([[[0, 0], [1, 0], [r.uniform(0, 1), r.uniform(0.4, 0.9)]]]).extrude(
        r.uniform(0.3, 0.9))


def _lens(r: np.random.Generator) -> Manifold:
    ball, apart = Manifold.sphere(0.6, 48), r.uniform(0.2, 0.42)
    return ball.translate([0, 0, apart]) ^ ball.translate([0, 0, -apart])


FAMILIES: dict[str, Callable[[np.random.Generator], Manifold]] = {
    f.__name__.lstrip("_"): f for f in (
        _block, _plate, _rod, _tube, _ring, _nut, _pin, _bracket, _elbow, _capsule, _ellipsoid,
        _cup, _star, _gear, _ribbon, _wedge, _lens)}


def make_shape(seed: int, family: str | None = None) -> Shape:
    """A random part of 15 to 45 mm; the same for the same seed and family.

    Raises:
        ShapeError: unknown family, or a solid that is no single watertight body.
    """
    random = np.random.default_rng([seed, 0x5A])
    if family is None:
        family = str(random.choice(list(FAMILIES)))
    if family not in FAMILIES:
        raise ShapeError(f"unknown family '{family}'; expected one of {sorted(FAMILIES)}")
    raw = FAMILIES[family](random).to_mesh()
    mesh = trimesh.Trimesh(raw.vert_properties[:, :3].astype(float), raw.tri_verts, process=False)
    mesh.merge_vertices()
    mesh.apply_scale(random.uniform(0.015, 0.045) / mesh.extents.max())
    if not mesh.is_watertight or mesh.volume <= 0 or mesh.body_count != 1:
        raise ShapeError(f"{family} (seed {seed}) has {mesh.body_count} bodies, volume "
                         f"{mesh.volume}, watertight {mesh.is_watertight}; expected one solid")
    return Shape(family, mesh.vertices - mesh.center_mass, mesh.faces.astype(np.int32))
