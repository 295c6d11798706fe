# SPDX-License-Identifier: Apache-2.0
"""Meshes of others become solids: fused, closed, simplified, of side 1; doubles go."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
import trimesh
from kits.collections import SOLIDS, make_collection

from stack_counter.sim.shapes import ShapeError
from stack_counter.sim.shapes.extra.collection import Origin, drop_doubles, solidify
from stack_counter.sim.shapes.extra.skin import make_skin
from stack_counter.sim.shapes.library import load_shapes

ORIGIN = Origin("x", "Yard", "CC BY 4.0", "Thing")
SCRIPTS = Path(__file__).parents[4] / "scripts"


def box(sides, at=(0, 0, 0)):
    return trimesh.creation.box(sides).apply_translation(at)


def volume(solid):
    return trimesh.Trimesh(solid.vertices / 65534, solid.faces).volume


def test_bodies_that_overlap_become_one_of_side_one():
    both = trimesh.util.concatenate([box([4, 2, 1]), box([1, 1, 2], [0, 0, 1])])
    solid = solidify(both, ORIGIN, 10.0)
    assert solid.size_mm == pytest.approx(40)
    assert np.ptp(solid.vertices.astype(int), axis=0)== pytest.approx([65534, 32767, 40959], abs=1)
    assert volume(solid) == pytest.approx((8 + 1.5) / 64, rel=1e-3)


def test_bodies_apart_are_refused():
    with pytest.raises(ShapeError, match="x: 2 bodies; expected 1"):
        solidify(trimesh.util.concatenate([box([1, 1, 1]), box([1, 1, 1], [3, 0, 0])]), ORIGIN, 1)


def test_loose_triangles_are_closed_by_a_skin():
    """A tube as triangles with gaps between them, some of them turned."""
    tube = trimesh.creation.annulus(0.44, 0.5, 0.6)
    triangles = tube.triangles.copy()
    triangles[::7] = triangles[::7, ::-1]
    middles = triangles.mean(axis=1, keepdims=True)
    corners = (middles + 0.97 * (triangles - middles)).reshape(-1, 3)
    solid = solidify(trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3),
                                     process=False), ORIGIN, np.nan)
    assert np.isnan(solid.size_mm) and len(solid.faces) <= 1500
    assert volume(solid) == pytest.approx(tube.volume, rel=0.05)


def test_a_skin_has_no_inside():
    hollow = trimesh.util.concatenate([box([1, 1, 1]), box([0.6, 0.6, 0.6])])
    skin = make_skin(hollow, 1500)
    assert skin.volume() == pytest.approx(1, rel=0.01) and skin.genus() == 0


def test_doubles_go():
    solids = [solidify(mesh.copy(), origin, mm) for origin, (mesh, mm) in SOLIDS.items()]
    turned = SOLIDS[next(iter(SOLIDS))][0].copy().apply_transform(
        trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1]))
    assert drop_doubles([*solids, solidify(turned, ORIGIN, 5.0)]) == solids


def test_a_folder_of_meshes_becomes_a_library(tmp_path, capsys):
    box([20, 12, 8]).export(tmp_path / "brick.stl")
    trimesh.creation.annulus(4, 6, 5).export(tmp_path / "ring.obj")
    (tmp_path / "torn.stl").write_text("solid no")
    (tmp_path / "table.csv").write_text(
        "file,source,licence,family,author,mm_per_unit\n"
        "brick.stl,Yard,CC BY 4.0,Brick,Ann,1\nring.obj,Yard,CC BY 4.0,Ring,,\n"
        "torn.stl,Yard,CC BY 4.0,Brick,,1\nbrick.stl,Yard,CC BY 4.0,Brick,,1\n")
    script = runpy.run_path(str(SCRIPTS / "convert_shapes.py"))
    script["main"](tmp_path, tmp_path / "table.csv", tmp_path / "out.npz")
    brick, ring = load_shapes(tmp_path / "out.npz")
    assert (brick.family, ring.family) == ("Yard/Brick", "Yard/Ring")
    assert brick.part_size == pytest.approx(0.02, rel=1e-4)
    said = capsys.readouterr().out
    assert "refused torn.stl: " in said and "2 solids, 1 refused, 1 doubles" in said


def test_ldraw_parts_become_meshes_with_their_origin(tmp_path):
    parts, primitives = tmp_path / "ld/parts", tmp_path / "ld/p"
    parts.mkdir(parents=True)
    primitives.mkdir()
    (primitives / "square.dat").write_text("0 Square\n4 16 -1 0 -1 -1 0 1 1 0 1 1 0 -1\n")
    header = ("0 Brick  1 x 1\n0 Author: Ann [ann]\n"
              "0 !LICENSE Licensed under CC BY 4.0 : see CAreadme.txt\n")
    (parts / "1.dat").write_text(header + "1 16 0 0 0 10 0 0 0 1 0 0 0 10 SQUARE.DAT\n"
                                 "1 16 0 24 0 10 0 0 0 1 0 0 0 10 square.dat\n"
                                 "3 16 0 0 0 10 24 0 10 24 10\n")
    (parts / "2.dat").write_text(header.replace("Brick", "~Moved to 1"))
    (parts / "3.dat").write_text("0 Brick without a licence\n3 16 0 0 0 1 0 0 0 1 0\n")
    (parts / "4.dat").write_text(header + "1 16 0 0 0 1 0 0 0 1 0 0 0 1 lost.dat\n")
    script = runpy.run_path(str(SCRIPTS / "ldraw_meshes.py"))
    script["main"](tmp_path / "ld", tmp_path / "out", 1)
    assert (tmp_path / "out/table.csv").read_text().splitlines()[1:] == [
        "1.stl,LDraw,CC BY 4.0,Brick,Ann [ann],0.4"]
    mesh = trimesh.load(tmp_path / "out/1.stl")
    assert len(mesh.faces) == 5 and mesh.extents.tolist() == [20, 20, 24]
    assert not list((tmp_path / "out").glob("[234].stl"))


def test_what_a_collection_says_of_its_solids_stays_with_them(tmp_path):
    make_collection(tmp_path / "real.npz")
    shapes = json.loads((tmp_path / "real.json").read_text())["shapes"]
    assert shapes[0] == {"id": "a/brick", "source": "BrickYard", "licence": "CC BY 4.0",
                         "family": "Brick", "author": "Ann", "size_mm": 20.0}
    assert shapes[1]["size_mm"] is None
