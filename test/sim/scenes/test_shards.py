# SPDX-License-Identifier: Apache-2.0
"""Scenes in files: what is read is what was written, and damage of any kind is refused."""

import errno
from collections import Counter
from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.sim import Scene, read_scenes
from stack_counter.sim.scenes import shards
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.pose_packing import pack_poses, unpack_poses
from stack_counter.sim.scenes.scene import SceneError
from stack_counter.sim.scenes.set_library import LIBRARY_FILE
from stack_counter.sim.scenes.shards import (
    SCENES_PER_SHARD,
    read_failed_tries,
    read_shard,
    shard_path,
    write_shard,
)
from stack_counter.sim.shapes import Shape, ShapeError, make_shape, shape_from_mesh

BLOCK, NUT = make_shape(0, "block"), make_shape(3, "nut")
SKIPPED = Counter({"unsettled": 2, "penetration": 1})


def stable(poses):
    """Poses as they are stored."""
    return unpack_poses(pack_poses(poses))


def made(index, shape, kind, count):
    random = np.random.default_rng([7, index])
    poses = np.concatenate([random.uniform([-0.05, -0.04, 0.01], [0.05, 0.04, 0.08], (count, 3)),
                            Rotation.random(count, random_state=index).as_quat().reshape(-1, 4)],
                           axis=1)
    c, s = np.cos(0.3 + index), np.sin(0.3 + index)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([0.01, -0.03, 0]))
    container = ContainerShape("none", T, (0.3, 0.3, 0.0)) if kind == "none" else ContainerShape(
        kind, T, (0.12, 0.1, 0.07), 0.004, 0.005, 0.05, 2**31 - 1 - index)
    return Scene(11, index, shape, container, stable(poses), random.uniform(0.2, 0.7),
                 random.uniform(0, 0.3), int(random.integers(7)))


@pytest.fixture(scope="module")
def scenes():
    return [made(50, BLOCK, "bin", 20), made(51, BLOCK, "bag", 12), made(52, NUT, "none", 15),
            made(53, NUT, "bowl", 1)]


@pytest.fixture
def shard(scenes, tmp_path):
    write_shard(tmp_path / "shard_00001.npz", scenes, SKIPPED)
    return tmp_path / "shard_00001.npz"


def assert_same(got, want):
    assert (got.seed, got.index, got.friction, got.restitution, got.taps) == (
        want.seed, want.index, want.friction, want.restitution, want.taps)
    assert (got.shape.family, got.shape.seed) == (want.shape.family, want.shape.seed)
    np.testing.assert_array_equal(got.shape.vertices, want.shape.vertices)
    np.testing.assert_array_equal(got.poses, want.poses)
    for field in fields(ContainerShape):
        a, b = (getattr(s.container, field.name) for s in (got, want))
        assert type(a) is type(b), field.name
        np.testing.assert_array_equal(a, b)
    for field in fields(type(want.truth)):
        a, b = (getattr(s.truth, field.name) for s in (got, want))
        np.testing.assert_array_equal(a, b, err_msg=field.name)


def test_what_is_read_is_what_was_written(scenes, shard):
    back = read_shard(shard)
    assert len(back) == len(scenes)
    for got, want in zip(back, scenes):
        assert_same(got, want)
        assert got.stored_truth is not None
        again = replace(got, stored_truth=None).truth  # measured anew from the poses as read
        np.testing.assert_array_equal(again.stack_volume, want.truth.stack_volume)
    assert read_failed_tries(shard) == SKIPPED
    assert [p.name for p in shard.parent.iterdir()] == [shard.name], "no .part stays"


def test_a_scene_takes_little_more_than_ten_bytes_a_part(shard, scenes, tmp_path):
    poses = made(1, BLOCK, "bin", 2000).poses
    many = replace(scenes[0], poses=poses, stored_truth=scenes[0].truth)
    write_shard(tmp_path / "many.npz", [many], Counter())
    more = (tmp_path / "many.npz").stat().st_size - shard.stat().st_size
    assert more < 10.2 * 2000


def test_the_same_scenes_give_the_same_bytes(scenes, shard, tmp_path):
    write_shard(tmp_path / "again.npz", scenes, Counter(dict(reversed(SKIPPED.items()))))
    assert (tmp_path / "again.npz").read_bytes() == shard.read_bytes()


def test_what_was_read_is_written_as_it_was(scenes, shard, tmp_path):
    write_shard(tmp_path / "copy.npz", read_shard(shard), read_failed_tries(shard))
    assert (tmp_path / "copy.npz").read_bytes() == shard.read_bytes()


def test_scenes_come_in_order_and_only_as_many_as_asked_for(scenes, shard, tmp_path):
    write_shard(shard_path(tmp_path, 0), [made(0, BLOCK, "bin", 3)], Counter())
    assert shard_path(tmp_path, 1) == shard and SCENES_PER_SHARD == 50
    assert [s.index for s in read_scenes(tmp_path)] == [0, 50, 51, 52, 53]
    assert [s.index for s in read_scenes(tmp_path, 2)] == [0, 50]
    assert list(read_scenes(tmp_path, 0)) == []
    with pytest.raises(SceneError, match="no shard_"):
        next(read_scenes(tmp_path / "elsewhere"))


@pytest.mark.parametrize("keep", [0, 1, 100, 0.5, -100, -1])
def test_a_cut_shard_is_refused(shard, keep):
    whole = shard.read_bytes()
    shard.write_bytes(whole[:int(keep * len(whole)) if keep == 0.5 else keep])
    with pytest.raises(SceneError, match=f"{shard.name} is no whole shard"):
        read_shard(shard)


def test_no_flipped_bit_gives_other_scenes(scenes, shard):
    whole = shard.read_bytes()
    refused, tries = 0, np.random.default_rng(0).integers(8 * len(whole), size=150)
    for bit in tries:
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        shard.write_bytes(damaged)
        try:
            back = read_shard(shard)
        except SceneError as error:
            assert shard.name in str(error)
            refused += 1
            continue
        for got, want in zip(back, scenes, strict=True):  # e.g. in a date that nobody reads
            assert_same(got, want)
    assert refused > 0.5 * len(tries)


@pytest.mark.parametrize("foreign", ["other arrays", "other format", "pickle", "text"])
def test_what_is_no_shard_is_refused(shard, foreign):
    if foreign == "text":
        shard.write_text("index,count\n0,20\n")
    elif foreign == "pickle":
        np.save(shard.with_suffix(".npy"), np.array([{}], object))
        shard.with_suffix(".npy").replace(shard)
    else:
        arrays = {"a": np.zeros(3)}
        if foreign == "other format":
            with np.load(shard) as file:
                arrays = {**file, "format": "stack_counter scenes 99"}
        np.savez(shard, **arrays)
    with pytest.raises(SceneError, match=f"{shard.name} is no whole shard"):
        read_shard(shard)


def test_parts_of_another_version_of_the_generators_are_refused(shard, monkeypatch):
    def larger(seed, family):
        shape = make_shape(seed, family)
        return Shape(family, shape.vertices * (1.001 if family == "nut" else 1), shape.faces, seed)

    monkeypatch.setattr(shards, "make_shape", larger)
    with pytest.raises(SceneError, match="nut 3 has .* another version of") as error:
        read_shard(shard)
    assert str(shard) in str(error.value)


def test_library_parts_are_read_from_the_file_beside(tmp_path):
    parts = [shape_from_mesh(m.vertices, m.faces, "brick", i) for i, m in enumerate(
        trimesh.creation.box([0.03, 0.02, z]) for z in (0.01, 0.015))]
    parts = [replace(p, vertices=p.vertices.astype(np.float32).astype(float)) for p in parts]
    want = made(0, parts[1], "bin", 12)
    write_shard(tmp_path / "shard_00000.npz", [want], Counter())
    with pytest.raises(SceneError, match="no .*shapes.npz, .*: ln -srf FILE .*shapes.npz; "):
        read_shard(tmp_path / "shard_00000.npz")
    (tmp_path / LIBRARY_FILE).write_text("no archive")
    with pytest.raises(ShapeError, match="shapes.npz"):
        read_shard(tmp_path / "shard_00000.npz")
    np.savez(tmp_path / LIBRARY_FILE, families=["brick"] * 2, vertex_offsets=[0, 8, 16],
             face_offsets=[0, 12, 24],
             vertices=np.concatenate([p.vertices for p in parts]).astype(np.float32),
             faces=np.concatenate([p.faces for p in parts]))
    (got,) = read_shard(tmp_path / "shard_00000.npz")
    assert (got.shape.family, got.shape.seed) == ("brick", 1)
    np.testing.assert_allclose(got.shape.vertices, parts[1].vertices, atol=1e-9)
    np.testing.assert_array_equal(got.poses, want.poses)


@pytest.mark.parametrize("place", ["stack_counter.sim.scenes.shards.np.savez_compressed",
                                   "stack_counter.sim.scenes.shards.os.fsync",
                                   "stack_counter.sim.scenes.shards.os.replace"])
def test_a_full_disk_leaves_what_was_there(scenes, shard, monkeypatch, place):
    whole = shard.read_bytes()

    def full(file, *_args, **_arrays):
        if hasattr(file, "write"):
            file.write(b"PK")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(place, full)
    with pytest.raises(OSError, match="No space left"):
        write_shard(shard, scenes[:1], Counter())
    assert [p.name for p in shard.parent.iterdir()] == [shard.name]
    assert shard.read_bytes() == whole
