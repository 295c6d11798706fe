# SPDX-License-Identifier: Apache-2.0
"""CAD files: what is taken, what is put right, and what is refused by name."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from kits.memory import limited_memory

from stack_counter.errors import MeshError
from stack_counter.teaching.part_mesh import SETTINGS, load_mesh_of_volume, load_part_mesh

BOX = trimesh.creation.box((20, 30, 40))


def written(tmp_path, mesh, name="part.stl"):
    mesh.export(tmp_path / name)
    return tmp_path / name


@pytest.mark.parametrize("name", ["part.stl", "part.obj", "part.ply", "part.off"])
def test_a_solid_in_millimetres(tmp_path, name):
    part = load_part_mesh(written(tmp_path, BOX, name))
    assert part.unit_volume == pytest.approx(24e-6) and part.notes == ()
    assert part.size_m == pytest.approx([0.02, 0.03, 0.04])
    assert np.abs(part.vertices.mean(axis=0)).max() < 1e-9


def test_the_volume_of_a_known_part_says_the_unit_of_its_file(tmp_path):
    path = written(tmp_path, trimesh.creation.box((2, 3, 4)))
    assert load_mesh_of_volume(path, 24 * 0.0254**3).size_m == pytest.approx([0.0508, 0.0762,
                                                                              0.1016])
    with pytest.raises(MeshError, match="in in v is 393.29 cm3; expected 30 cm3"):
        load_mesh_of_volume(path, 30e-6)
    with pytest.raises(FileNotFoundError):
        load_mesh_of_volume(tmp_path / "none.stl", 24e-6)


def test_a_sliver_may_close_a_seam(tmp_path):
    """One long edge of the box meets two short ones: a triangle of no height lies between."""
    mesh = trimesh.creation.box((20, 30, 40))
    a, b = mesh.faces[0][:2]
    middle = len(mesh.vertices)
    vertices = np.vstack([mesh.vertices, (mesh.vertices[a] + mesh.vertices[b]) / 2])
    c = mesh.faces[0][2]
    faces = np.vstack([mesh.faces[1:], [[a, middle, c], [middle, b, c], [a, b, middle]]])
    part = load_part_mesh(written(tmp_path, trimesh.Trimesh(vertices, faces, process=False)))
    assert part.unit_volume == pytest.approx(24e-6)


def test_other_units(tmp_path):
    small = trimesh.creation.box((0.02, 0.03, 0.04))
    assert load_part_mesh(written(tmp_path, small), "m").unit_volume == pytest.approx(24e-6)
    inches = trimesh.creation.box((1.0, 1.0, 2.0))
    assert load_part_mesh(written(tmp_path, inches), "in").unit_volume == pytest.approx(
        2 * 0.0254**3)


@pytest.mark.parametrize("size, unit, likely", [
    (0.04, "mm", r"m \(40 mm\)"), (1.5, "mm", r"in \(38.1 mm\)"), (40.0, "m", r"mm \(40 mm\)")])
def test_the_likely_unit_mistake_is_named(tmp_path, size, unit, likely):
    path = written(tmp_path, trimesh.creation.box((size,) * 3))
    with pytest.raises(MeshError, match=f"expected 3 to 500 mm; its unit may be .*{likely}"):
        load_part_mesh(path, unit)


def test_inside_out_is_turned(tmp_path):
    turned = BOX.copy()
    turned.invert()
    part = load_part_mesh(written(tmp_path, turned))
    assert part.unit_volume == pytest.approx(24e-6) and "inside out" in part.notes[0]


def test_open_meshes_are_refused(tmp_path):
    torn = BOX.copy()
    torn.update_faces(np.arange(11))
    with pytest.raises(MeshError, match="not watertight: 3 of 18 edges"):
        load_part_mesh(written(tmp_path, torn))


def test_several_bodies_are_refused_but_voids_are_part_of_it(tmp_path):
    two = trimesh.util.concatenate([BOX, BOX.copy().apply_translation((50, 0, 0))])
    with pytest.raises(MeshError, match="2 bodies; expected 1"):
        load_part_mesh(written(tmp_path, two))
    void = trimesh.creation.box((10, 10, 10))
    void.invert()
    part = load_part_mesh(written(tmp_path, trimesh.util.concatenate([BOX, void])))
    assert part.unit_volume == pytest.approx(24e-6) and "1 closed voids" in part.notes[0]


def test_many_triangles_are_made_fewer_with_the_same_volume(tmp_path):
    ball = trimesh.creation.icosphere(6, radius=10)
    part = load_part_mesh(written(tmp_path, ball))
    mesh = trimesh.Trimesh(part.vertices, part.faces)
    assert len(part.faces) <= SETTINGS.max_faces < len(ball.faces) and mesh.is_watertight
    assert part.unit_volume == pytest.approx(ball.volume * 1e-9)
    assert mesh.volume == pytest.approx(part.unit_volume, rel=1e-6)


@pytest.mark.parametrize("name, data, what", [
    ("a.txt", b"", "ends in '.txt'"), ("a.stl", b"nonsense", "a.stl"), ("a.obj", b"", "a.obj"),
    ("a.ply", b"ply\nformat x", "cannot be read")])
def test_what_is_no_mesh_is_refused_in_one_line(tmp_path, name, data, what):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(MeshError, match=what) as caught:
        load_part_mesh(tmp_path / name)
    assert "\n" not in str(caught.value) and "expected" in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match="no mesh"):
        load_part_mesh(tmp_path / "none.stl")


def test_step_without_a_reader_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (tmp_path / "a.step").write_text("ISO-10303-21;")
    with pytest.raises(MeshError, match=r"stack_counter\[cad\]"):
        load_part_mesh(tmp_path / "a.step")


def test_step_files_say_their_unit():
    pytest.importorskip("cascadio", reason="the extra 'cad' is not installed")
    part = load_part_mesh(Path(__file__).parent / "block.step", "m")  # 30 x 20 x 10 mm, bored
    assert part.size_m == pytest.approx([0.03, 0.02, 0.01], rel=1e-4)
    assert part.unit_volume == pytest.approx(6e-6 - np.pi * 0.004**2 * 0.01, rel=1e-3)


STATES_TOO_MUCH = {
    "stl": b"\0" * 80 + (2**32 - 1).to_bytes(4, "little") + b"\0" * 50,
    "ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
           b"property float y\nproperty float z\nelement face 4000000000\n"
           b"property list uchar int vertex_indices\nend_header\n" + b"\0" * 50,
    "off": b"OFF\n4000000000 4000000000 0\n0 0 0\n"}


@pytest.mark.parametrize("suffix", STATES_TOO_MUCH)
def test_a_file_that_states_more_than_it_holds_is_refused_before_room_is_made(tmp_path, suffix):
    path = tmp_path / f"part.{suffix}"
    path.write_bytes(STATES_TOO_MUCH[suffix])
    with limited_memory(), pytest.raises(MeshError, match="expected"):
        load_part_mesh(path)
