# SPDX-License-Identifier: Apache-2.0
"""Sets of real solids: the folder names the library by its content, and holds no copy of it."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from kits.collections import make_collection

from stack_counter.sim import read_scenes
from stack_counter.sim.dataset import simulate
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.pose_packing import pack_poses, unpack_poses
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.scenes.set_library import find_library, library_digest
from stack_counter.sim.scenes.shards import write_shard
from stack_counter.sim.shapes.library import open_library
from stack_counter.tasks.workers import Workers


@pytest.fixture
def collection(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    make_collection(tmp_path / "elsewhere/real.npz")
    return tmp_path / "elsewhere/real.npz"


@pytest.fixture
def folder(tmp_path, collection):
    """A set with two scenes of the collection, as `simulate` leaves it."""
    shapes, folder = open_library(collection), tmp_path / "train-real"
    simulate(folder, 0, Workers(), 7, "deep", collection)
    poses = np.tile([0, 0, 0.02, 0, 0, 0, 1.0], (3, 1))
    poses[:, 0] = [-0.04, 0, 0.04]
    box = ContainerShape("bin", np.eye(4), (0.3, 0.3, 0.1), 0.003, 0.003)
    scene = Scene(7, 0, shapes[0], box, unpack_poses(pack_poses(poses)))
    write_shard(folder / "shard_00000.npz", [scene, replace(scene, index=1, shape=shapes[2])],
                Counter())
    return folder


def test_scenes_of_a_collection_are_read_by_a_link_to_it(folder, collection):
    assert (folder / "shapes.npz").is_symlink()
    scenes = list(read_scenes(folder))
    assert [s.shape.family for s in scenes] == ["BrickYard/Brick", "ChipShop/Pin_THT"]
    assert json.loads((folder / "run.json").read_text()) == {
        "seed": 7, "plan": "deep", "library": library_digest(collection),
        "credits": {"BrickYard, CC BY 4.0": 2, "ChipShop, CC-BY-SA 4.0": 1}}
    simulate(folder, 0, Workers(), 7, "deep", folder / "shapes.npz")
    assert (folder / "shapes.npz").resolve() == collection


def test_a_set_without_its_library_says_how_to_get_it(folder, collection):
    digest = library_digest(collection)
    collection.unlink()
    with pytest.raises(SceneError) as caught:
        list(read_scenes(folder))
    assert str(caught.value) == (
        f"no {folder}/shapes.npz, the shapes that the scenes are made of; link the file of "
        f"SHA-256 {digest}...: ln -srf FILE {folder}/shapes.npz; data/README.md says where it "
        "comes from")


def test_another_library_is_refused(folder, collection):
    expected = library_digest(collection)
    with np.load(collection) as file:
        arrays = dict(file)
    np.savez(collection, **{**arrays, "size_mm": arrays["size_mm"] * 1.01})
    with pytest.raises(SceneError, match=f"is another library, .*; link the .* {expected}"):
        find_library(folder)
