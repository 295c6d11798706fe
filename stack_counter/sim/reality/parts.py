# SPDX-License-Identifier: Apache-2.0
"""The parts of published experiments, from their published sizes.

Each is scaled so that its mesh has the closed form's volume: facets would take some percent of it.
"""

from __future__ import annotations

import numpy as np
import trimesh
from manifold3d import Manifold

from stack_counter.sim.shapes import Shape, shape_from_mesh
from stack_counter.sim.shapes.solids import SIDES, bar, box, cylinder, union

_MM = 1e-3
# Edge of a die: gamma does not depend on it.
_DIE_M = 0.016
_GOLDEN = (1 + 5**0.5) / 2
# Corners of the other dice, any size.
_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_DICE = {
    "tetrahedron": _SIGNS[np.prod(_SIGNS, axis=1) > 0],
    "cube": _SIGNS,
    "octahedron": np.concatenate([np.eye(3), -np.eye(3)]),
    "dodecahedron": np.concatenate([_SIGNS, *(
        np.roll([[0, a / _GOLDEN, b * _GOLDEN] for a in (-1, 1) for b in (-1, 1)], k, axis=1)
        for k in range(3))]),
    "icosahedron": np.concatenate([
        np.roll([[0, a, b * _GOLDEN] for a in (-1, 1) for b in (-1, 1)], k, axis=1)
        for k in range(3)]),
}


def die(name: str) -> Shape:
    """A Platonic solid with sharp edges."""
    mesh = trimesh.convex.convex_hull(_DICE[name])
    edge = mesh.edges_unique_length.min()
    return shape_from_mesh(mesh.vertices * _DIE_M / edge, mesh.faces, name)


def ellipsoid(name: str, *axes_mm: float) -> Shape:
    """An ellipsoid of three axes, millimetres."""
    mesh = trimesh.creation.icosphere(3, 0.5)
    factor = (np.pi / 6 / mesh.volume) ** (1 / 3) * _MM
    return shape_from_mesh(mesh.vertices * factor * np.array(axes_mm), mesh.faces, name)


def ring(name: str, diameter_mm: float, height_mm: float, wall_mm: float) -> Shape:
    """A piece of tube."""
    factor = _circle_factor(SIDES)
    solid = cylinder(height_mm, diameter_mm / 2 * factor) \
        - cylinder(2 * height_mm, (diameter_mm / 2 - wall_mm) * factor)
    return _shape(solid, name)


def ring_of_volume(name: str, diameter_mm: float, volume_mm3: float) -> Shape:
    """A ring as high as wide, whose wall follows from its volume."""
    filled = volume_mm3 / (np.pi / 4 * diameter_mm**3)
    return ring(name, diameter_mm, diameter_mm, diameter_mm / 2 * (1 - (1 - filled) ** 0.5))


def rod(aspect: float, sides: int = 12) -> Shape:
    """A straight cylinder of so many diameters, 2 mm thick."""
    solid = cylinder(2 * aspect, _circle_factor(sides), sides)
    return _shape(solid, f"rod {aspect:g}")


def almond(length_mm: float, width_mm: float, thickness_mm: float, volume_mm3: float) -> Shape:
    """An almond kernel: half an ellipsoid and a cone on it, parted so as to give the volume."""
    # Of the length's share f the half ellipsoid fills 2/3 of its bounding cylinder, the cone 1/3.
    filled = volume_mm3 / (np.pi / 4 * length_mm * width_mm * thickness_mm)
    blunt = 3 * filled - 1
    factor = _circle_factor(4 * SIDES)
    ball = Manifold.sphere(factor, 4 * SIDES).scale([1, 1, blunt * length_mm])
    solid = ball.trim_by_plane([0, 0, -1], 0) + Manifold.cylinder(
        (1 - blunt) * length_mm, factor, 0, 4 * SIDES)
    return _shape(solid.scale([width_mm / 2, thickness_mm / 2, 1]), "almond kernel")


def corn_kernel(length_mm: float, width_mm: float, thickness_mm: float, volume_mm3: float
                ) -> Shape:
    """A wedge with round edges, as narrow at its tip as gives the volume."""
    radius = thickness_mm / 4

    def wedge(tip_mm: float) -> Manifold:
        x, z = length_mm / 2 - radius, thickness_mm / 2 - radius
        corners = [(-x, tip_mm / 2 - radius), (x, width_mm / 2 - radius)]
        return Manifold.batch_hull([
            bar(np.array([x, sign * y, -z]), np.array([x, sign * y, z]), radius, radius, SIDES)
            for x, y in corners for sign in (-1, 1)])

    low, high = 2 * radius, width_mm
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (middle, high) if wedge(middle).volume() < volume_mm3 else (low, middle)
    return _shape(wedge(low), "corn kernel")


def toy_brick() -> Shape:
    """A LEGO brick of 2 x 4 studs, after its well-known drawing, millimetres.

    Its tubes are open below; the little hollows under the studs are left out.
    """
    factor = _circle_factor(SIDES)
    length, width, height, wall, top = 31.8, 15.8, 9.6, 1.5, 1.0
    hollow = box(length - 2 * wall, width - 2 * wall, height).translate([0, 0, -top])
    pitch, stud, stud_height = 8.0, 4.8, 1.7
    stud_z = (height + stud_height - top) / 2  # from the hollow's ceiling upwards
    studs = [cylinder(top + stud_height, factor * stud / 2).translate([x * pitch, y * pitch,
                                                                       stud_z])
             for x in (-1.5, -0.5, 0.5, 1.5) for y in (-0.5, 0.5)]
    tube = cylinder(height, factor * 6.51 / 2) - cylinder(2 * height, factor * 4.8 / 2)
    under_top = box(length, width, height).translate([0, 0, -top])
    tubes = [(tube ^ under_top).translate([x * pitch, 0, 0]) for x in (-1, 0, 1)]
    return _shape(union([box(length, width, height) - hollow, *studs, *tubes]), "toy brick")


def _circle_factor(sides: int) -> float:
    """Radius of a regular polygon over that of the circle of the same area."""
    angle = 2 * np.pi / sides
    return float(np.sqrt(angle / np.sin(angle)))


def _shape(solid: Manifold, name: str) -> Shape:
    """The solid, millimetres, as a part."""
    raw = solid.to_mesh64()
    return shape_from_mesh(raw.vert_properties[:, :3] * _MM, raw.tri_verts, name)
