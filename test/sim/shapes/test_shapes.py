# SPDX-License-Identifier: Apache-2.0
"""The training parts: every family is one solid, its measures those of closed forms."""

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection

from stack_counter.sim.shapes import FAMILIES, ShapeError, make_shape, shape_from_mesh
from stack_counter.sim.shapes.shape import REFERENCE_CURVATURE

BOX = trimesh.creation.box([0.04, 0.03, 0.02])
BALL = trimesh.creation.icosphere(4, 0.02)
RESERVED = {"screw", "bearing", "tee", "cross", "bottle", "jar", "pulley", "wheel", "u_channel",
            "z_clip", "knob", "brick"}


def shape_of(mesh, **kwargs):
    return shape_from_mesh(mesh.vertices, mesh.faces, "given", **kwargs)


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_gives_one_solid(family):
    for seed in range(8):
        shape = make_shape(seed, family)
        assert shape.mesh.is_volume and shape.mesh.body_count == 1
        assert 0.015 <= shape.part_size <= 0.045 * (1 + 1e-12) and 0 < shape.convexity <= 1
        assert len(shape.faces) <= 1200 and shape.complexity > 0
        np.testing.assert_allclose(shape.mesh.center_mass, 0, atol=1e-9)
        again = make_shape(seed, family)
        np.testing.assert_array_equal(shape.vertices, again.vertices)
        np.testing.assert_array_equal(shape.faces, again.faces)


def test_families_are_many_varied_and_not_those_of_the_test():
    assert len(FAMILIES) >= 27 and not RESERVED & set(FAMILIES)
    shapes = [make_shape(seed) for seed in range(200)]
    assert len({s.family for s in shapes}) > 40
    assert len({round(s.unit_volume * 1e12) for s in shapes}) > 195
    assert min(s.convexity for s in shapes) < 0.25 and max(s.convexity for s in shapes) == 1
    assert max(s.scaled_curvature for s in shapes) <= REFERENCE_CURVATURE
    with pytest.raises(ShapeError, match="unknown family 'banana'; expected one of"):
        make_shape(0, "banana")


def test_a_box_in_closed_form():
    box = shape_of(BOX)
    assert box.unit_volume == pytest.approx(0.04 * 0.03 * 0.02, rel=1e-12)
    assert box.part_size == pytest.approx(0.04) and box.convexity == pytest.approx(1)
    kappa = 4 * (0.04 + 0.03 + 0.02) * (np.pi / 2) / 2
    diagonal = np.linalg.norm([0.04, 0.03, 0.02])
    assert box.complexity == pytest.approx(kappa / diagonal / REFERENCE_CURVATURE, rel=1e-6)
    assert box.seed == -1


def test_a_ball_in_closed_form():
    ball = shape_of(BALL)
    assert ball.unit_volume == pytest.approx(4 / 3 * np.pi * 0.02**3, rel=0.005)
    # The sphere's integral of 1 / R is 4 pi R; the diagonal of its box 2 R sqrt(3).
    assert ball.complexity == pytest.approx(
        2 * np.pi / np.sqrt(3) / REFERENCE_CURVATURE, rel=0.005
    )


def test_concave_edges_add_to_the_complexity():
    outline = [[(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]]
    angle = CrossSection(outline).extrude(1).to_mesh64()
    shape = shape_from_mesh(angle.vert_properties, angle.tri_verts, "angle", part_size=0.02)
    kappa = (2 * 8 + 6) * np.pi / 4  # two outlines of length 8, six upright edges of length 1
    assert shape.convexity == pytest.approx(3 / 3.5)
    assert shape.complexity == pytest.approx(kappa / 3 / REFERENCE_CURVATURE + 0.5 / 3.5, rel=1e-6)


def test_scale_place_and_duplicate_vertices_do_not_matter():
    soup = BOX.vertices[BOX.faces].reshape(-1, 3) * 1000 + [5, 6, 7]
    shape = shape_from_mesh(soup, np.arange(36).reshape(12, 3), "soup", 3, part_size=0.04)
    assert shape.vertices.shape == (8, 3) and shape.faces.dtype == np.int32 and shape.seed == 3
    assert shape.unit_volume == pytest.approx(BOX.volume)
    np.testing.assert_allclose(shape.mesh.center_mass, 0, atol=1e-12)


def _with_nan():
    vertices = np.array(BOX.vertices)
    vertices[3, 1] = np.nan
    return vertices


FAR = trimesh.util.concatenate([BOX, BOX.copy().apply_translation([0.1, 0, 0])])
SHEET = trimesh.creation.box([0.04, 0.04, 1e-6])
FINE = trimesh.creation.icosphere(6, 0.02)


@pytest.mark.parametrize("vertices, faces, message", [
    (BOX.vertices, BOX.faces[1:], "3 edges do not join two faces; expected a watertight mesh"),
    (FAR.vertices, FAR.faces, "2 bodies; expected 1"),
    (_with_nan(), BOX.faces, "1 of 8 vertices are NaN or infinite; expected finite"),
    (BOX.vertices * 100, BOX.faces, r"part size 4 m; expected 0.001 to 0.5 m"),
    (BOX.vertices / 100, BOX.faces, r"part size 0.0004 m; expected 0.001 to 0.5 m"),
    (BOX.vertices, BOX.faces[:, ::-1], "volume -2.4e-05 m3.* expected at least 6.4e-09 m3"),
    (SHEET.vertices, SHEET.faces, "volume 1.6e-09 m3.* expected at least 6.4e-09 m3"),
    (FINE.vertices, FINE.faces, "81920 faces; expected at most 20000"),
    (BOX.vertices, BOX.faces + 1, "face indices 1 to 8; expected 0 to 7"),
    (BOX.vertices[:, :2], BOX.faces, r"vertices have shape \(8, 2\); expected \(n, 3\)"),
    (BOX.vertices, BOX.faces[:0], r"faces have shape \(0, 3\); expected \(n, 3\), n > 0"),
])
def test_a_bad_mesh_is_refused_in_one_line(vertices, faces, message):
    with pytest.raises(ShapeError, match="^given: .*" + message) as error:
        shape_from_mesh(vertices, faces, "given")
    assert "\n" not in str(error.value)
