# SPDX-License-Identifier: Apache-2.0
"""Collections of others' solids: as they were written, with origin and size, or refused."""

import json
import pickle

import numpy as np
import pytest
from kits.collections import make_collection

from stack_counter.sim.shapes import SIZES_M, ShapeError
from stack_counter.sim.shapes.library import load_shapes, open_library, source_of


@pytest.fixture
def path(tmp_path):
    make_collection(tmp_path / "real.npz")
    return tmp_path / "real.npz"


def test_solids_keep_form_origin_and_a_size_that_is_known(path):
    brick, slab, pin = load_shapes(path)
    assert [s.family for s in (brick, slab, pin)] == [
        "BrickYard/Brick", "BrickYard/Slab", "ChipShop/Pin_THT"]
    assert [s.seed for s in (brick, slab, pin)] == [0, 1, 2]
    np.testing.assert_allclose(np.sort(np.ptp(brick.vertices, axis=0)), [0.008, 0.012, 0.02],
                               rtol=1e-4)
    assert brick.unit_volume == pytest.approx(0.02 * 0.012 * 0.008, rel=1e-3)
    assert [source_of(s.family) for s in (slab, pin)] == ["BrickYard", "ChipShop"]
    assert source_of("block") == ""
    assert open_library(path).credits == {"BrickYard, CC BY 4.0": 2, "ChipShop, CC-BY-SA 4.0": 1}


def test_an_unknown_size_and_one_that_is_not_simulated_are_drawn_once_for_all(path):
    _, slab, pin = load_shapes(path)  # unknown; 2 mm
    for shape in (slab, pin):
        assert SIZES_M[0] <= shape.part_size <= SIZES_M[1]
    assert slab.part_size != pytest.approx(pin.part_size)
    assert [s.part_size for s in load_shapes(path)[1:]] == [slab.part_size, pin.part_size]


def test_a_process_that_gets_a_library_reads_the_file_itself(path):
    library = open_library(path)
    sent = pickle.dumps(library)
    assert len(sent) < 500
    again = pickle.loads(sent)
    np.testing.assert_array_equal(again[2].vertices, library[2].vertices)
    assert len(again) == 3 and [s.seed for s in again[1:]] == [1, 2]
    with pytest.raises(IndexError, match="shape 3 of .*; expected 0 to 2"):
        library[3]


@pytest.mark.parametrize("damage", ["no index", "other index", "index cut", "short offsets",
                                    "no licence"])
def test_a_damaged_collection_is_refused(path, damage):
    index = path.with_suffix(".json")
    shapes = json.loads(index.read_text())["shapes"]
    if damage == "no index":
        index.unlink()
    elif damage == "other index":
        index.write_text(json.dumps({"shapes": shapes[::-1]}))
    elif damage == "index cut":
        index.write_text(index.read_text()[:100])
    elif damage == "no licence":
        index.write_text(json.dumps({"shapes": [{"id": s["id"]} for s in shapes]}))
    else:
        with np.load(path) as file:
            arrays = dict(file)
        np.savez(path, **{**arrays, "foff": arrays["foff"][:-1]})
    with pytest.raises(ShapeError, match="real.npz: .*; expected an npz of shapes") as caught:
        open_library(path)
    assert "\n" not in str(caught.value)
