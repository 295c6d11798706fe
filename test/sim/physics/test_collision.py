# SPDX-License-Identifier: Apache-2.0
"""Convex pieces: every form gets some, they keep the form, and are the same again."""

import dataclasses

import numpy as np
import open3d as o3d
import pytest
import trimesh
from kits.cad_parts import CAD_PARTS, mesh_of

pytest.importorskip("coacd", reason="the physics has no wheel for this Python")

from stack_counter.sim.physics import collision
from stack_counter.sim.physics.decomposition import cache, flat_cuts
from stack_counter.sim.physics.decomposition.form import measure_form
from stack_counter.sim.physics.decomposition.merging import merge_pieces
from stack_counter.sim.physics.decomposition.voronoi import cut_voronoi
from stack_counter.sim.shapes import ShapeError, make_shape, shape_from_mesh
from stack_counter.sim.shapes.simplify import simplify_solid


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    collision._known_pieces.cache_clear()


@pytest.fixture
def no_flat_cuts(monkeypatch):
    """As if the search for flat cuts ended for no mesh."""
    monkeypatch.setattr(flat_cuts, "cut_flat", lambda *args: [])


def cad_shape(part):
    return shape_from_mesh(*mesh_of(part), part, part_size=0.03)


def box_corners(low, high):
    return np.array(trimesh.creation.box(bounds=[low, high]).vertices)


@pytest.mark.parametrize("part", ["mug", "ring", "wire_frame"])
def test_flat_cuts_keep_the_form(part):
    shape = cad_shape(part)
    pieces = collision.convex_pieces(shape)
    form = measure_form(shape.mesh, pieces)
    assert 1 < len(pieces) <= 24 and max(map(len, pieces)) <= 32
    assert 0.98 < form.fullness < 1.4 and form.protrusion < 0.03


@pytest.mark.parametrize("part", CAD_PARTS)
def test_voronoi_cells_keep_the_form_where_flat_cuts_find_no_end(part, no_flat_cuts):
    shape = cad_shape(part)
    pieces = collision.convex_pieces(shape)
    form = measure_form(shape.mesh, pieces)
    assert len(pieces) in (24, 48) and 1 < form.fullness < 1.7 and form.protrusion < 0.04


def test_a_convex_part_is_its_hull():
    pieces = collision.convex_pieces(make_shape(0, "block"))
    assert [len(corners) for corners in pieces] == [8]


def test_the_form_of_boxes():
    """A cube of 1 beside one of 2: nine times as full; and its far half stands out by 1 to 2."""
    cube = trimesh.creation.box(bounds=[[0, 0, 0], [1, 1, 1]])
    same = measure_form(cube, [box_corners([0, 0, 0], [1, 1, 0.6]),
                               box_corners([0, 0, 0.4], [1, 1, 1])])
    assert same.fullness == pytest.approx(1) and same.farthest < 1e-6
    large = measure_form(cube, [box_corners([0, 0, 0], [1, 1, 3])])
    assert large.fullness == pytest.approx(3) and large.farthest == pytest.approx(2, abs=0.01)


def test_those_are_merged_whose_common_hull_adds_least():
    """Of three boxes, the two in one line add nothing; what is flat is left out."""
    line = [box_corners([0, 0, 0], [1, 1, 1]), box_corners([1, 0, 0], [2, 1, 1])]
    beside = box_corners([0, 1, 0], [1, 4, 3])
    flat = box_corners([0, 0, 0], [1, 1, 1]) * [1, 1, 0]
    pieces = merge_pieces([line[0], beside, line[1], flat], 2)
    assert sorted(tuple(np.ptp(corners, axis=0)) for corners in pieces) == [(1, 3, 3), (2, 1, 1)]


def test_no_more_cuts_than_the_budget(monkeypatch):
    shape = cad_shape("tee")
    assert len(flat_cuts.cut_flat(shape.vertices, shape.faces, 0.2)) > 1
    monkeypatch.setattr(flat_cuts, "SETTINGS", dataclasses.replace(flat_cuts.SETTINGS, max_cuts=2))
    assert flat_cuts.cut_flat(shape.vertices, shape.faces, 0.2) == []


def test_a_process_that_dies_of_something_else_gives_no_other_pieces():
    with pytest.raises(flat_cuts.CutterError, match="ended with 1; expected 0"):
        flat_cuts.cut_flat(np.zeros((2, 2)), np.zeros((1, 3), np.int32), 0.2)


def test_pieces_are_kept_on_disk_and_are_the_same_again(tmp_path, no_flat_cuts, monkeypatch):
    shape = cad_shape("wire_frame")
    made = collision.convex_pieces(shape)
    stored, = tmp_path.rglob("*.npz")
    # From the disk
    collision._known_pieces.cache_clear()
    monkeypatch.setattr(collision, "_decompose", None)
    read = collision.convex_pieces(shape)
    assert all((a == b).all() for a, b in zip(made, read, strict=True))
    # Damaged: made again
    content = stored.read_bytes()
    stored.write_bytes(content[:60] + bytes(40) + content[100:])
    assert cache.load_pieces(stored.stem) is None
    stored.write_bytes(content[:100])
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(flat_cuts, "cut_flat", lambda *args: [])
    collision._known_pieces.cache_clear()
    again = collision.convex_pieces(shape)
    assert all((a == b).all() for a, b in zip(made, again, strict=True))
    assert cache.load_pieces(stored.stem) is not None


def test_a_folder_that_cannot_be_written_costs_time_only(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    cache.store_pieces("00", [np.zeros((4, 3))])
    assert cache.load_pieces("00") is None


def test_the_key_depends_on_the_mesh_and_the_settings():
    mesh = cad_shape("tee")
    keys = {cache.cache_key(vertices, mesh.faces, settings)
            for vertices in (mesh.vertices, mesh.vertices + 1) for settings in (1, 2)}
    assert len(keys) == 4


def test_a_part_whose_form_even_most_pieces_miss_is_told(monkeypatch):
    tee = cad_shape("tee")
    assert collision.rough_form(tee) is None
    monkeypatch.setattr(collision, "SETTINGS",
                        dataclasses.replace(collision.SETTINGS, max_fullness=1.01))
    assert collision.rough_form(tee).fullness > 1.01


def test_fine_meshes_are_made_coarse_at_the_same_volume():
    ball = trimesh.creation.icosphere(5)
    coarse = simplify_solid(ball, 2000)
    assert len(coarse.faces) <= 2000 and coarse.is_watertight
    assert coarse.volume == pytest.approx(ball.volume, rel=1e-6)
    assert coarse.center_mass == pytest.approx(np.zeros(3), abs=1e-3)
    assert simplify_solid(coarse, 2000) is coarse


def test_a_mesh_that_tears_at_every_decimation_is_made_coarse_as_a_manifold(monkeypatch):
    """A box with 30,000 faces, of which the usual decimation makes two bodies."""
    fine = trimesh.creation.box((1, 1, 1)).subdivide().subdivide().subdivide().subdivide() \
        .subdivide()
    torn = trimesh.util.concatenate(trimesh.creation.box(), trimesh.creation.box((3, 1, 1)))
    halves = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(torn.vertices),
                                       o3d.utility.Vector3iVector(torn.faces))
    monkeypatch.setattr(o3d.geometry.TriangleMesh, "simplify_quadric_decimation",
                        lambda mesh, faces: halves)
    coarse = simplify_solid(fine, 2000)
    assert coarse.is_watertight and coarse.body_count == 1 and len(coarse.faces) <= 2000
    assert coarse.volume == pytest.approx(1) and coarse.extents == pytest.approx(np.ones(3))


def test_what_makes_no_solid_is_refused_with_what_to_do():
    box = trimesh.creation.box((1, 1, 1))
    torn = trimesh.Trimesh(box.vertices, box.faces[:-1], process=False)
    with pytest.raises(ShapeError, match="no solid: .*: export the part again"):
        cut_voronoi(torn)
