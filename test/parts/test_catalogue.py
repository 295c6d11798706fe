# SPDX-License-Identifier: Apache-2.0
"""The part catalogue: what it holds, what of it is refused, and that nothing gets lost."""

from dataclasses import replace

import pytest
from kits.known_parts import COUNTED, gamma_model

from stack_counter.errors import ConfigError, PartError
from stack_counter.parts.catalogue import Part, load_parts, remove_part, save_part
from stack_counter.parts.part_lookup import check_names_a_part, resolve_part
from stack_counter.parts.part_models import PartModels
from stack_counter.types import KnownLevel, MeshMeasures, PartRequest
from stack_counter.weighing.joined_count import SETTINGS as WEIGHING
from stack_counter.weighing.joined_count import PieceWeight


def test_a_part_survives_the_file(tmp_path):
    path = tmp_path / "parts.yaml"
    PartModels("network 7", gamma_model(), gamma_model(), "64 piles").write(
        tmp_path / "parts" / "nut.json"
    )
    part = Part(6.0e-6, "nut: #1", 1e-8, tmp_path / "nut.stl", 2700.0, (0.2, 0.5),
                tmp_path / "parts" / "nut.json", tmp_path / "parts" / "nut.safetensors",
                "from nut.stl", (COUNTED, COUNTED))
    save_part(part, path)
    save_part(Part(1e-6, "other"), path)
    parts = load_parts(path)
    assert set(parts) == {"nut: #1", "other"}
    again = parts["nut: #1"]
    assert replace(again, unit_volume=part.unit_volume, unit_volume_std=1e-8) == part
    assert again.unit_volume == pytest.approx(6.0e-6, rel=1e-12)
    assert again.models.made == "64 piles" and "parts/nut.json" in path.read_text()
    remove_part("nut: #1", path)
    assert set(load_parts(path)) == {"other"}
    with pytest.raises(PartError, match="unknown part 'nut: #1'; expected one of"):
        remove_part("nut: #1", path)


@pytest.mark.parametrize("std_kg, pieces", [(2e-5, 50), (1e-4, 1)])
def test_the_weight_of_a_piece_survives_the_file(tmp_path, std_kg, pieces):
    weight = PieceWeight(4.7e-3, std_kg, pieces)
    save_part(Part(6e-6, "nut", piece_weight=weight), tmp_path / "parts.yaml")
    assert load_parts(tmp_path / "parts.yaml")["nut"].piece_weight == weight


def test_a_weight_alone_has_the_usual_spread_and_number_of_pieces(tmp_path):
    (tmp_path / "parts.yaml").write_text("parts: {a: {unit_volume_cm3: 1, piece_weight_g: 2}}")
    weight = load_parts(tmp_path / "parts.yaml")["a"].piece_weight
    assert weight == PieceWeight(2e-3, 2e-3 * WEIGHING.piece_std_share)


USERS = """\
# Parts of cell 7.
parts:
  # Fasteners
  bolt: {unit_volume_cm3: 3}  # M8
  "nut":
    unit_volume_cm3: 1.5  # weighed, 2026-02-03
    # Steel:
    density_g_cm3: 7.85

  # Pasta
  spiral:
    unit_volume_cm3: 1.05
# end
"""


def test_comments_and_order_of_a_users_file_stay(tmp_path):
    path = tmp_path / "parts.yaml"
    path.write_text(USERS)
    parts = load_parts(path)
    save_part(replace(parts["nut"], note="turned: #1", counted=(COUNTED,)), path)
    added = path.read_text()
    assert load_parts(path)["nut"].counted == (COUNTED,) and list(load_parts(path)) == list(parts)
    lines = added.splitlines()
    assert [line for line in lines if line in USERS.splitlines()] == USERS.splitlines()
    assert lines[7:9] == ["    density_g_cm3: 7.85", '    note: "turned: #1"']
    for _ in range(2):
        save_part(replace(load_parts(path)["nut"], counted=(COUNTED, COUNTED)), path)
        save_part(replace(load_parts(path)["nut"], counted=(COUNTED,)), path)
    assert path.read_text() == added
    save_part(parts["nut"], path)
    assert path.read_text() == USERS, "what is taken back leaves nothing"
    save_part(Part(4e-6, "yes"), path)
    assert path.read_text().replace('  "yes":\n    unit_volume_cm3: 4.0\n', "") == USERS
    remove_part("yes", path)
    remove_part("nut", path)
    assert path.read_text() == USERS[:USERS.index('  "nut"')] + USERS[USERS.index("\n  # Pasta"):]


def test_what_could_not_be_read_again_is_not_written(tmp_path):
    path = tmp_path / "parts.yaml"
    save_part(Part(1e-6, "good"), path)
    with pytest.raises(ConfigError, match="friction"):
        save_part(Part(1e-6, "bad", friction=(0.2, 3.0)), path)
    assert set(load_parts(path)) == {"good"}


@pytest.mark.parametrize("text, what", [
    ("parts: {a: {unit_volume_cm3: 1, colour: red}}", "key 'colour'"),
    ("parts: {a: {mesh: x.stl}}", "no unit_volume_cm3"),
    ("parts: {a: {unit_volume_cm3: -1}}", "-1"),
    ("parts: {a: {unit_volume_cm3: many}}", "'a': unit_volume_cm3 'many'"),
    ("parts: {a: {unit_volume_cm3: true}}", "'a': unit_volume_cm3 True"),
    ("parts: {a: {unit_volume_cm3: 1, friction: [a, 1]}}", "'a': friction 'a'"),
    ("parts: {a: {unit_volume_cm3: 1, friction: [0.2, 3]}}", "'a': friction [0.2, 3]"),
    ("parts: {a: {unit_volume_cm3: 1, friction: 0.2}}", "friction 0.2 (least and most needed)"),
    ("parts: {a: {unit_volume_cm3: 1, piece_weight_sd_g: 1}}", "without piece_weight_g"),
    ("parts: {a: {unit_volume_cm3: 1, piece_weight_g: 0}}", "a weight above 0"),
    ("parts: {a: {unit_volume_cm3: 1, piece_weight_g: 2, piece_weight_pieces: 1.5}}",
     "piece_weight_g 2 of 1.5 pieces"),
    ("parts: {a: {unit_volume_cm3: 1, friction: [0, 0.2]}}", "'a': friction [0, 0.2]"),
    ("parts: {a: {unit_volume_cm3: 1, size_mm: 5}}", "'a': size_mm 5"),
    ("parts: {a: {unit_volume_cm3: 1, size_mm: [10, 10, 0]}}", "'a': size_mm [10, 10, 0]"),
    ("parts: {a: {unit_volume_cm3: 1, size_mm: [10, 10, 9]}}", "a box of 0.9 cm3"),
    ("parts: {a: {unit_volume_cm3: 1, size_mm: [1000, 100, 9]}}", "a box of 900 cm3"),
    ("parts: {a: {unit_volume_cm3: 1, mesh_measures: {solidity: 0.5, surface_cm2: 1, holes: 1, "
     "gyration_mm: [1, 1, 1]}}}", "without size_mm"),
    ("parts: {a: {unit_volume_cm3: 1, size_mm: [10, 10, 10], mesh_measures: {holes: 1}}}",
     "'a': mesh_measures"),
    ("parts: {a: {unit_volume_cm3: 1, size_mm: [10, 10, 10], mesh_measures: "
     "{solidity: 2, surface_cm2: 1, holes: 1, gyration_mm: [1, 1, 1]}}}", "solidity above 0 to 1"),
    ("parts: {a: {unit_volume_cm3: 1, counted: 5}}", "'a': counted 5"),
    ("parts: {1: {unit_volume_cm3: 1}, '1': {unit_volume_cm3: 2}}", "two entries '1'"),
    ("parts: {a: {unit_volume_cm3: 1}, a: {unit_volume_cm3: 2}}", "two entries 'a'"),
    ("parts: {a: {unit_volume_cm3: 1, unit_volume_cm3: 2}}", "two entries"),
    ("parts: {a: {unit_volume_cm3: 1, friction: [0.7, 0.2]}}", "friction"),
    ("parts: {a: {unit_volume_cm3: 1, density_g_cm3: -2}}", "density_g_cm3"),
    ("parts: {a: {unit_volume_cm3: 1, counted: [{count: 3}]}}", "counted"),
    ("parts: {a: 5}", "keys needed"), ("teile: {}", "teile"), ("5", "5"), ("parts: [", "line"),
])
def test_a_catalogue_edited_wrongly_says_where(tmp_path, text, what):
    path = tmp_path / "parts.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_parts(path)
    message = str(caught.value)
    assert what in message and "expected" in message and "\n" not in message


def test_a_counted_scan_with_impossible_numbers_is_refused(tmp_path):
    path = tmp_path / "parts.yaml"
    save_part(Part(1e-6, "a", counted=(COUNTED,)), path)
    path.write_text(path.read_text().replace("count: 240", "count: -1"))
    with pytest.raises(ConfigError, match="-1"):
        load_parts(path)


def test_names_and_volumes_resolve(tmp_path):
    path = tmp_path / "parts.yaml"
    save_part(Part(2e-6, "nut", counted=(COUNTED,)), path)
    assert resolve_part(PartRequest("nut", 0.0), str(path)).counted == (COUNTED,)
    assert resolve_part(PartRequest("nut", 2e-6), str(path)).counted == (COUNTED,)
    assert resolve_part(PartRequest("nut", 3e-6), str(path)) == Part(3e-6, "nut", overridden=True)
    assert resolve_part(PartRequest("bolt", 3e-6), str(path)) == Part(3e-6, "bolt")
    assert resolve_part(PartRequest("", 3e-6)) == Part(3e-6)
    with pytest.raises(PartError, match=r"unknown part 'bolt'; expected one of \['nut'\]"):
        resolve_part(PartRequest("bolt", 0.0), str(path))
    with pytest.raises(PartError, match="expected one of them"):
        resolve_part(PartRequest("", 0.0))
    with pytest.raises(PartError, match="above 0"):
        resolve_part(PartRequest("", -1.0))
    with pytest.raises(ConfigError, match="no part catalogue"):
        resolve_part(PartRequest("nut", 0.0), str(tmp_path / "none.yaml"))


def test_a_prior_that_is_gone_is_told(tmp_path):
    path = tmp_path / "parts.yaml"
    save_part(Part(2e-6, "nut", gamma_prior=tmp_path / "nut.json"), path)
    with pytest.raises(PartError, match="no gamma prior"):
        resolve_part(PartRequest("nut", 0.0), str(path))


def test_the_shipped_catalogue_can_be_read():
    parts = load_parts()
    assert parts["pasta_spiral"].unit_volume == pytest.approx(1.05476e-6)
    assert all(part.models is not None for part in parts.values() if part.gamma_prior)


def test_outer_dimensions_and_measures_of_the_mesh_come_back(tmp_path):
    path = tmp_path / "parts.yaml"
    measures = MeshMeasures(0.45, 0.01, 2, (0.012, 0.011, 0.003))
    part = Part(1e-6, "bracket", outer_size_m=(0.03, 0.02, 0.01), mesh_measures=measures)
    save_part(part, path)
    assert load_parts(path)["bracket"] == part
    assert part.form.level == KnownLevel.MESH and Part(1e-6).form.level == KnownLevel.VOLUME


def test_outer_dimensions_that_are_given_override_those_of_the_catalogue(tmp_path):
    path = tmp_path / "parts.yaml"
    save_part(Part(1e-6, "nut", outer_size_m=(0.03, 0.02, 0.01), counted=(COUNTED,)), path)
    given = (0.02, 0.01, 0.01)
    assert resolve_part(PartRequest("nut"), str(path)).outer_size_m == (0.03, 0.02, 0.01)
    part = resolve_part(PartRequest("nut", outer_size_m=given), str(path))
    assert part.outer_size_m == given and part.counted == (COUNTED,)
    assert resolve_part(PartRequest("", 1e-6, given)).outer_size_m == given
    with pytest.raises(PartError, match=r"20 x 10 x 10 mm, a box of 2 cm3 .*as v is 3 cm3"):
        resolve_part(PartRequest("", 3e-6, given))
    with pytest.raises(PartError, match="no part named"):
        resolve_part(PartRequest(outer_size_m=given))


def test_a_given_size_unlike_the_meshs_takes_its_measures_away(tmp_path):
    path = tmp_path / "parts.yaml"
    measures = MeshMeasures(0.45, 0.01, 2, (0.012, 0.011, 0.003))
    save_part(Part(1e-6, "nut", outer_size_m=(0.03, 0.02, 0.01), mesh_measures=measures), path)
    near, far = (resolve_part(PartRequest("nut", outer_size_m=size), str(path))
                 for size in ((0.0102, 0.0202, 0.0303), (0.02, 0.02, 0.01)))
    assert near.form.level == KnownLevel.MESH and far.form.level == KnownLevel.SIZE


def test_outer_dimensions_alone_are_refused():
    with pytest.raises(PartError, match="without part or unit_volume"):
        check_names_a_part(PartRequest(outer_size_m=(0.03, 0.02, 0.01)))
