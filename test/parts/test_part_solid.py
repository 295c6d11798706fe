# SPDX-License-Identifier: Apache-2.0
"""A part's CAD file as poses need it: in metres, in its own axes, read once."""

import os

import numpy as np
import pytest
import trimesh

from stack_counter.errors import PartError
from stack_counter.parts.catalogue import Part
from stack_counter.parts.part_solid import read_part_surface


def box_file(folder, *sides):
    """A box in millimetres, of which one corner is at the file's origin."""
    path = folder / "box.stl"
    trimesh.creation.box(sides).apply_translation(np.array(sides) / 2).export(path)
    return path


def test_the_surface_is_in_metres_and_keeps_the_axes_of_its_file(tmp_path):
    part = Part(6e-6, "box", mesh=box_file(tmp_path, 10, 20, 30))
    mesh = read_part_surface(part)
    assert mesh.vertices.min(axis=0) == pytest.approx([0, 0, 0])
    assert mesh.vertices.max(axis=0) == pytest.approx([0.01, 0.02, 0.03])
    assert mesh.triangles.shape == (12, 3)


def test_a_file_is_read_again_only_when_it_has_changed(tmp_path):
    part = Part(6e-6, "box", mesh=box_file(tmp_path, 10, 20, 30))
    mesh = read_part_surface(part)
    assert read_part_surface(Part(6e-6, "box", mesh=part.mesh)) is mesh
    box_file(tmp_path, 30, 20, 10)
    os.utime(part.mesh, ns=(1, 1))
    assert read_part_surface(part).vertices.max(axis=0) == pytest.approx([0.03, 0.02, 0.01])


def test_a_part_without_a_file_has_no_surface_and_a_missing_or_foreign_file_is_an_error(tmp_path):
    assert read_part_surface(Part(6e-6)) is None
    with pytest.raises(PartError, match="mesh of part 'box'.*none.stl"):
        read_part_surface(Part(6e-6, "box", mesh=tmp_path / "none.stl"))
    with pytest.raises(PartError, match="expected 7 cm3"):
        read_part_surface(Part(7e-6, "box", mesh=box_file(tmp_path, 10, 20, 30)))
