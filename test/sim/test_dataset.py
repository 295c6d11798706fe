# SPDX-License-Identifier: Apache-2.0
"""Runs: the same scenes for a seed, however many workers, and after any break."""

import dataclasses
import json
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections import Counter

import numpy as np
import pytest
from kits.recipes import Few, Hopeless

from stack_counter.sim import read_scenes
from stack_counter.sim.dataset import simulate
from stack_counter.sim.physics.drop import make_scene
from stack_counter.sim.physics.recipes import Recipe
from stack_counter.sim.scenes.scene import SceneError
from stack_counter.sim.scenes.shards import shard_path
from stack_counter.sim.shapes import make_shape
from stack_counter.tasks.workers import Workers

pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")

LIBRARY = (make_shape(0, "block"), make_shape(9, "block"), make_shape(10, "block"))
PER_SHARD = 10
SEED, COUNT = 5, 2 * PER_SHARD + 5  # two full shards and one begun
RECIPE = Few(library=LIBRARY)


def made(out, scenes=COUNT, workers=1, recipe=RECIPE):
    """`simulate` with small shards and a recipe of small scenes; its processes get it as any."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stack_counter.sim.dataset.Recipe", lambda *_: recipe)
        patch.setattr("stack_counter.sim.dataset.SCENES_PER_SHARD", PER_SHARD)
        simulate(out, scenes, Workers(workers), SEED)


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("shard_*"))}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A whole run of one worker, undisturbed."""
    out = tmp_path_factory.mktemp("run")
    made(out)
    return out


def test_a_scene_depends_on_recipe_seed_and_index_alone():
    first = [make_scene(SEED, i, RECIPE, Counter()) for i in (0, 1, 7)]
    again = [make_scene(SEED, i, RECIPE, Counter()) for i in (7, 1, 0)][::-1]
    for a, b in zip(first, again):
        assert a.shape is b.shape
        np.testing.assert_array_equal(a.poses, b.poses)
        np.testing.assert_array_equal(a.container.inner_size_m, b.container.inner_size_m)
    other = make_scene(SEED + 1, 1, RECIPE, Counter())
    assert other.container.inner_size_m != first[1].container.inner_size_m


def test_a_run_of_the_training_families_has_one_part_for_three_scenes():
    recipe = Recipe()
    shapes = [recipe.draw_shape(3, i, 0) for i in range(7)]
    assert [(s.family, s.seed) for s in shapes[:3]] == [(shapes[0].family, shapes[0].seed)] * 3
    assert len({s.seed for s in shapes}) == 3
    assert recipe.draw_shape(3, 0, 1).seed == shapes[0].seed != recipe.draw_shape(3, 0, 2).seed


def test_a_library_is_taken_in_turn():
    taken = [RECIPE.draw_shape(3, i, 0) for i in range(6)]
    assert {id(s) for s in taken[:3]} == {id(s) for s in LIBRARY}
    assert [id(s) for s in taken[:3]] == [id(s) for s in taken[3:]]


def test_a_run_makes_the_scenes_asked_for_and_logs_them(run):
    scenes = list(read_scenes(run))
    assert [s.index for s in scenes] == list(range(COUNT)) and {s.seed for s in scenes} == {SEED}
    assert {s.shape.seed for s in scenes} == {0, 9, 10}
    for i in (1, PER_SHARD + 2):  # what lies there is what is made here
        here = make_scene(SEED, i, RECIPE, Counter())
        np.testing.assert_array_equal(scenes[i].poses, here.poses)
        assert scenes[i].truth.stack_volume == here.truth.stack_volume
    lines = [json.loads(line) for line in (run / "simulate.log").read_text().splitlines()]
    assert sorted((x["shard"], x["scenes"]) for x in lines) == [
        (0, PER_SHARD),
        (1, PER_SHARD),
        (2, 5),
    ]
    assert sum(x["parts"] for x in lines) == sum(s.truth.count for s in scenes)
    assert not list(run.glob("*.part"))


def test_two_workers_and_a_killed_one_give_the_same_files(run, tmp_path, caplog):
    """The worker is killed when the first shard is there, in the middle of the others."""
    killed = []

    def kill():
        while not shard_path(tmp_path, 0).exists() and not shard_path(tmp_path, 1).exists():
            time.sleep(0.01)
        victim = multiprocessing.active_children()[0]
        killed.append(victim.pid)
        os.kill(victim.pid, signal.SIGKILL)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    with caplog.at_level(logging.ERROR):
        made(tmp_path, workers=2)
    thread.join(10)
    assert killed and "a worker was killed" in caplog.text
    assert contents(tmp_path) == contents(run)


def test_scenes_of_another_seed_are_not_mixed_in(run):
    with pytest.raises(SceneError, match="made from .*'seed': 5.*; expected .*'seed': 6"):
        simulate(run, 1, Workers(), SEED + 1)


@pytest.mark.parametrize("damage, message", [
    (b"", "is damaged: Expecting value.*; expected what simulate wrote there"),
    (b'{"seed": 5, "pl', "is damaged: Unterminated string.*; expected what simulate wrote there"),
    (b"\x80\xff", "is damaged: 'utf-8' codec .*; expected what simulate wrote there"),
    (b"[5]\n", r"holds \[5\]; expected an object with seed, plan and library"),
])
def test_a_damaged_note_of_what_a_run_is_made_from_is_refused(tmp_path, damage, message):
    (tmp_path / "run.json").write_bytes(damage)
    with pytest.raises(SceneError, match="run.json " + message) as error:
        simulate(tmp_path, 1, Workers(), SEED)
    assert "\n" not in str(error.value)
    assert (tmp_path / "run.json").read_bytes() == damage, "it stays for whoever looks into it"


def test_a_run_resumes_where_it_stopped(run, tmp_path):
    whole = contents(run)
    names = sorted(whole)
    (tmp_path / names[0]).write_bytes(whole[names[0]])
    damaged = bytearray(whole[names[1]])
    damaged[len(damaged) // 2] ^= 255
    (tmp_path / names[1]).write_bytes(damaged)
    (tmp_path / "shard_00002.part").write_bytes(b"PK")  # of a run that was killed as it wrote
    before = os.stat(tmp_path / names[0]).st_mtime_ns
    made(tmp_path)
    assert contents(tmp_path) == whole, "the damaged and the missing one are made again"
    assert os.stat(tmp_path / names[0]).st_mtime_ns == before, "the whole one is left alone"
    made(tmp_path)
    assert len((tmp_path / "simulate.log").read_text().splitlines()) == 2, "nothing to do"


def test_what_cannot_be_made_is_named_at_the_end(tmp_path):
    with pytest.raises(SceneError, match="1 of 1 shards in .* are missing: scene 0 of seed 5 "
                                         "failed 30 times: {'container too small': 30}"):
        made(tmp_path, 2, recipe=Hopeless(library=LIBRARY))
    assert not list(tmp_path.glob("shard_*"))


def test_the_parts_of_a_library_lie_beside_the_scenes(tmp_path):
    parts = [make_shape(i, "block") for i in (0, 10)]
    np.savez(tmp_path / "some.npz", families=["crate", "brick"],
             vertex_offsets=np.cumsum([0, *(len(p.vertices) for p in parts)]),
             face_offsets=np.cumsum([0, *(len(p.faces) for p in parts)]),
             vertices=np.concatenate([p.vertices for p in parts]).astype(np.float32),
             faces=np.concatenate([p.faces for p in parts]))
    small_piles = 25  # a seed
    simulate(tmp_path / "out", 2, Workers(), small_piles, "box", tmp_path / "some.npz")
    scenes = list(read_scenes(tmp_path / "out"))
    assert {s.shape.family for s in scenes} == {"crate", "brick"}
    for scene in scenes:
        again = dataclasses.replace(scene, stored_truth=None).truth
        assert again.stack_volume == pytest.approx(scene.truth.stack_volume, rel=1e-4)
        assert scene.container.kind == "bin" and scene.truth.count >= 20
