# SPDX-License-Identifier: Apache-2.0
"""Parts that may lie below the surface: in the page, apart from what was seen."""

import io
import re
from base64 import b64decode

import numpy as np
import pytest
import trimesh
from kits.counted_bin import counted_bin, plausible_parts

from stack_counter.display.page.arranged_parts import SETTINGS, arrangement_to_show
from stack_counter.display.page.subject import ReportSubject
from stack_counter.display.report import write_report


def test_each_part_lies_where_it_was_put_in_a_pale_colour_of_its_own():
    arrangement = plausible_parts()
    mesh = arrangement_to_show(arrangement)
    parts = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).split()
    assert sorted(part.centroid.tolist() for part in parts) == pytest.approx(
        np.array(sorted(T[:3, 3].tolist() for T in arrangement.T_world_parts)), abs=1e-6)
    assert len(np.unique(mesh.colors, axis=0)) == len(parts)
    assert mesh.colors.min() > 255 * (SETTINGS.value - SETTINGS.saturation) - 1


def test_many_parts_are_shown_with_few_triangles():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.01)
    many = plausible_parts(count=200, part=ball)
    assert len(arrangement_to_show(many).triangles) <= SETTINGS.max_triangles
    assert arrangement_to_show(plausible_parts(count=0)) is None


def test_the_page_holds_them_hidden_and_the_model_beside_it_does_not(tmp_path):
    write_report(tmp_path, counted_bin(), [],
                 ReportSubject("bin 7", arrangement=plausible_parts()))
    page = (tmp_path / "report.html").read_text()
    assert "One plausible arrangement, not seen: 6 of the 9 parts of a simulated pile" in page
    assert "the nearest of 4 piles, off by 5.0 mm" in page
    inside = b64decode(re.search(r"data:model/gltf-binary;base64,([^\"]+)", page)[1])
    seen = (tmp_path / "surface.glb").read_bytes()
    models = [trimesh.load(io.BytesIO(glb), file_type="glb").geometry for glb in (inside, seen)]
    assert [list(model) for model in models] == [["surface", "container", "plausible parts"],
                                                 ["surface", "container"]]
    hidden = models[0]["plausible parts"].visual.material
    assert hidden.alphaMode == "MASK" and hidden.baseColorFactor[3] == 0
    assert "plausible_parts.ply" in page and (tmp_path / "plausible_parts.ply").is_file()


def test_a_page_without_them_has_nothing_to_look_below(tmp_path):
    write_report(tmp_path, counted_bin(), [])
    assert 'class="inside"' not in (tmp_path / "report.html").read_text()
