# SPDX-License-Identifier: Apache-2.0
"""The unseen test set: what it must hold, and that a damaged file is refused."""

from pathlib import Path

import numpy as np
import pytest

from stack_counter.sim.shapes import FAMILIES, ShapeError
from stack_counter.sim.shapes.library import load_shapes

PATH = Path(__file__).parents[4] / "data/unseen/shapes.npz"


@pytest.fixture(scope="module")
def shapes():
    return load_shapes(PATH)


def test_the_set_is_large_and_of_several_origins(shapes):
    with np.load(PATH) as file:
        names, sources = file["names"], file["sources"]
    assert len(shapes) == len(names) == len(set(names)) >= 60
    assert len(set(sources)) >= 3
    assert [s.family for s in shapes] == [name.split("/")[1] for name in names]
    assert [s.seed for s in shapes] == list(range(len(shapes)))


def test_no_family_is_trained_on(shapes):
    assert {s.family for s in shapes}.isdisjoint(FAMILIES)


def test_each_is_one_small_watertight_body(shapes):
    for s in shapes:
        assert s.mesh.is_watertight and s.mesh.body_count == 1 and s.unit_volume > 0, s.family
        assert len(s.faces) <= 3000 and 0.0149 < s.part_size < 0.0451, s.family
        assert np.abs(s.mesh.center_mass).max() < 1e-6, s.family


@pytest.mark.parametrize("damage", ["missing", "cut", "text", "no faces", "hole", "short offsets"])
def test_a_damaged_file_is_refused(tmp_path, damage):
    path = tmp_path / "shapes.npz"
    with np.load(PATH) as file:
        arrays = dict(file)
    if damage == "no faces":
        del arrays["faces"]
    elif damage == "hole":
        arrays["faces"] = arrays["faces"][1:]
    elif damage == "short offsets":
        arrays["face_offsets"] = arrays["face_offsets"][:-1]
    if damage == "cut":
        path.write_bytes(PATH.read_bytes()[:5000])
    elif damage == "text":
        path.write_text("no archive")
    elif damage != "missing":
        np.savez(path, **arrays)
    with pytest.raises(ShapeError) as caught:
        load_shapes(path)
    assert "\n" not in str(caught.value)
