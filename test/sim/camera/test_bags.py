# SPDX-License-Identifier: Apache-2.0
"""Recordings of simulated scenes: what a cell would record, and the truth beside it."""

import json
from collections import Counter

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from stack_counter.cli import main
from stack_counter.errors import BagError
from stack_counter.sim import Scene
from stack_counter.sim.camera.bags import (
    remove_parts,
    write_picks_bag,
    write_scene_bag,
    write_spread_bag,
)
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.shards import write_shard
from stack_counter.sim.shapes import make_shape
from stack_counter.teaching.part_mesh import load_part_mesh

COLOR, STATIC = "/camera/color/image_raw/compressed", "/tf_static"


@pytest.fixture(scope="module")
def scene():
    """Three blocks on top of each other beside a single one."""
    shape = make_shape(0, "block")
    size, high = shape.part_size, float(np.ptp(shape.vertices[:, 2]))
    poses = [[0, 0, (i + 0.5) * high + 0.003, 0, 0, 0, 1] for i in (1, 0, 2)]
    poses.append([1.5 * size, 0, 0.5 * high + 0.003, 0, 0, 0, 1])
    box = ContainerShape("bin", np.eye(4), (4.5 * size, 4 * size, 2 * size), 0.003, 0.003)
    return Scene(1, 0, shape, box, np.array(poses))


def counted(bag):
    with AnyReader([bag]) as reader:
        return {c.topic: c.msgcount for c in reader.connections}


def test_an_arm_records_an_arc_of_views(scene, tmp_path):
    write_scene_bag(scene, tmp_path / "bag", 3, seed=1)
    counts = counted(tmp_path / "bag")
    assert counts[COLOR] == counts["/camera/aligned_depth_to_color/image_raw"] == 3
    assert counts["/tf"] > 100 and STATIC not in counts  # 50 Hz over two seconds
    truth = json.loads((tmp_path / "bag" / "truth.json").read_text())
    assert truth["count"] == 4 and truth["family"] == "block"
    assert truth["volume_m3"] == pytest.approx(scene.truth.stack_volume)
    assert truth["gamma"] == pytest.approx(
        4 * truth["unit_volume_cm3"] * 1e-6 / truth["volume_m3"])


def test_beside_a_recording_lies_the_parts_mesh(scene, tmp_path):
    write_spread_bag(scene, tmp_path / "bag", 5, 3, seed=1)
    truth = json.loads((tmp_path / "bag" / "truth.json").read_text())
    assert truth["count"] == 5 and truth["family"] == "block"
    assert load_part_mesh(tmp_path / "bag" / "part.stl").unit_volume == pytest.approx(
        scene.shape.unit_volume, rel=1e-5)
    with pytest.raises(BagError, match="37 pieces; expected 1 to 36"):
        write_spread_bag(scene, tmp_path / "more", 37, 3, seed=1)


def test_picks_take_the_highest_part_first(scene):
    states = list(remove_parts(scene, 4))
    assert [len(s.poses) for s in states] == [4, 3, 2, 1, 0]
    high = scene.poses[:, 2]
    assert states[1].poses[:, 2].max() == np.sort(high)[-2]
    assert states[4].truth.count == 0 and states[4].truth.stack_volume == 0
    volumes = [s.truth.stack_volume for s in states]
    assert np.all(np.diff(volumes) < 0)


def test_a_fixed_camera_sees_the_picks(scene, tmp_path):
    write_picks_bag(scene, tmp_path / "bag", 2, seed=1)
    counts = counted(tmp_path / "bag")
    assert counts[COLOR] == 3 and counts[STATIC] == 1 and "/tf" not in counts
    truth = json.loads((tmp_path / "bag" / "truth.json").read_text())
    assert [entry["count"] for entry in truth["counts"]] == [4, 3, 2] and truth["count"] == 2
    with AnyReader([tmp_path / "bag"]) as reader:
        stamps = [stamp for c, stamp, _ in reader.messages() if c.topic == COLOR]
    assert stamps == [entry["stamp_ns"] for entry in truth["counts"]]


@pytest.mark.parametrize("write, number, reason", [
    (write_picks_bag, 5, "5 picks from 4 parts; expected 1 to"),
    (write_scene_bag, 2, "2 views; expected 3 to 200"),
])
def test_impossible_recordings_are_refused(scene, tmp_path, write, number, reason):
    with pytest.raises(BagError, match=reason):
        write(scene, tmp_path / "bag", number, 0)
    assert not (tmp_path / "bag").exists()


def test_the_command_names_what_is_missing(scene, tmp_path, capsys):
    assert main(["simulate"]) == 2
    assert "needs --scenes N and --out DIR" in capsys.readouterr().err
    folder = tmp_path / "scenes"
    folder.mkdir()
    write_shard(folder / "shard_00000.npz", [scene], Counter())
    for name, code, reason in ((f"{folder}:7", 2, "no scene 7 in"),
                               (f"{folder}", 3, "expected DIR:INDEX")):
        assert main(["simulate", "bag", name, str(tmp_path / "bag")]) == code
        assert reason in capsys.readouterr().err
