# SPDX-License-Identifier: Apache-2.0
"""Ordinary hollow parts as CAD programs make them, in millimetres and with coarse round edges."""

import numpy as np
from manifold3d import CrossSection, Manifold

SEGMENTS = 16  # of a circle: few, so that tests are quick


def macaroni():
    """A third of a bent tube with a wall of 1 mm."""
    section = CrossSection.circle(4, 12) - CrossSection.circle(3, 12)
    return section.translate((9, 0)).revolve(32, 120)


def tee():
    """A plumbing tee: two tubes that open into each other."""
    def cross(radius, length):
        arm = Manifold.cylinder(length / 2, radius, radius, SEGMENTS).rotate((90, 0, 0))
        return Manifold.cylinder(length, radius, radius, SEGMENTS, True) + arm
    return cross(6, 30) - cross(4.5, 31)


def brick():
    """A hollow toy brick with 2 x 4 studs, 32 x 16 x 9.6 mm."""
    body = Manifold.cube((32, 16, 9.6)) - Manifold.cube((29, 13, 8.1)).translate((1.5, 1.5, 0))
    stud = Manifold.cylinder(2, 2.4, 2.4, SEGMENTS)
    tube = Manifold.cylinder(8.2, 3.25, 3.25, SEGMENTS) \
        - Manifold.cylinder(8.2, 2.4, 2.4, SEGMENTS)
    for x in range(4):
        for y in range(2):
            body += stud.translate((4 + 8 * x, 4 + 8 * y, 9.5))
    for x in range(3):
        body += tube.translate((8 + 8 * x, 8, 0))
    return body


def mug():
    """A cup with a handle."""
    cup = Manifold.cylinder(30, 12, 12, SEGMENTS) \
        - Manifold.cylinder(30, 10.5, 10.5, SEGMENTS).translate((0, 0, 2))
    handle = CrossSection.circle(1.6, 8).translate((8, 0)).revolve(SEGMENTS) \
        .rotate((90, 0, 0)).translate((12, 0, 15))
    return cup + (handle - Manifold.cylinder(40, 11, 11, SEGMENTS))


def ring():
    """A Raschig ring, 25 x 25 mm with a wall of 0.8 mm."""
    return Manifold.cylinder(25, 12.5, 12.5, 2 * SEGMENTS) \
        - Manifold.cylinder(25, 11.7, 11.7, 2 * SEGMENTS)


def wire_frame():
    """The edges of a box as bars of 1.5 mm."""
    frame = Manifold()
    for axis, (a, b) in enumerate(((1, 2), (0, 2), (0, 1))):
        size = np.full(3, 1.5)
        size[axis] = 31.5
        for i in (0, 30):
            for j in (0, 30):
                corner = np.zeros(3)
                corner[a], corner[b] = i, j
                frame += Manifold.cube(tuple(size)).translate(tuple(corner))
    return frame


def fusilli():
    """Three thin blades, twisted once and a half."""
    blade = CrossSection.square((10, 1.2)).translate((0, -0.6))
    section = blade + blade.rotate(120) + blade.rotate(240)
    return section.extrude(30, 24, 540)


CAD_PARTS = {make.__name__: make
             for make in (macaroni, tee, brick, mug, ring, wire_frame, fusilli)}


def mesh_of(part):
    """Vertices (n, 3), mm, and faces (m, 3) of a part of `CAD_PARTS`."""
    mesh = CAD_PARTS[part]().to_mesh64()
    return mesh.vert_properties[:, :3], mesh.tri_verts
