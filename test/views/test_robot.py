# SPDX-License-Identifier: Apache-2.0
"""A robot over the bin: left out of every view's depth, or the view is skipped."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from kits.analytic import Scene
from kits.depth_camera import COLOR_CAMERA
from kits.recording_kit import FRAME, records, texture, tf_record, write
from kits.robot import add_arm, joint_record, write_urdf

from stack_counter import geometry
from stack_counter.bag.bag_views import BagViews
from stack_counter.bag.replay import measure_bag
from stack_counter.config import CollectorConfig, Config
from stack_counter.errors import ConfigError

INNER, FILL = (0.18, 0.14, 0.10), 0.06
T_WORLD_BASE = geometry.pose(np.eye(3), np.array([-0.35, 0.1, 0.0]))
STEP_NS = 20_000_000


def positions(i):
    """The hand stays in the bin while the camera goes round it, and turns a little."""
    return -0.3 + 0.02 * i, 0.23


@lru_cache
def scan(arm=True):
    """Six views of a filled bin with the arm over it."""
    bin_only = Scene().bin(INNER, 0.004, 0.004, FILL)
    views = bin_only.views(6, tilts=(10, 35), radius=0.7, camera=COLOR_CAMERA)
    views = [replace(v, stamp_ns=v.stamp_ns + 10**9, color=texture(COLOR_CAMERA, i), camera=FRAME)
             for i, v in enumerate(views)]
    if not arm:
        return views
    scenes = [add_arm(Scene().bin(INNER, 0.004, 0.004, FILL), T_WORLD_BASE, *positions(i))
              for i in range(6)]
    return [replace(v, depth=scene.view(v.T_world_camera, COLOR_CAMERA).depth)
            for scene, v in zip(scenes, views)]


def bag(path, joints=True, base=True):
    """The recording, with the joint states and the base's place or without."""
    out = records(scan())
    for i, view in enumerate(scan()):
        for step in (-1, 1) if joints else ():
            share = np.array(positions(i + step * 1e-3))  # it moves
            out.append(joint_record(view.stamp_ns + step * STEP_NS, share))
    if base:
        out.append(tf_record(1, T_WORLD_BASE, "robot_base", "base_link", "/tf_static"))
    return write(path, out)


@pytest.fixture
def config(tmp_path):
    return CollectorConfig(robot_description_file=str(write_urdf(tmp_path)))


def test_v_is_that_of_the_bin_without_the_arm(tmp_path, config):
    path, truth = bag(tmp_path / "bag"), np.prod(INNER[:2]) * FILL
    views = [view for _, view in BagViews(path, config)]
    for view, clear in zip(views, scan(arm=False)):
        seen = view.depth > 0
        assert 0.5 < seen.mean() < 0.98
        assert np.abs(view.depth - clear.depth)[seen].max() < 0.0006
    assert measure_bag(path, Config(collector=config)).stack_volume == pytest.approx(
        truth, rel=0.05)
    assert measure_bag(path, Config()).stack_volume > 2 * truth  # the arm counts as parts


@pytest.mark.parametrize("left_out, reason, said", [
    ("joints", "no_joint_state", "never came on /joint_states"),
    ("base", "no_tf", "no transforms connect 'base_link' and 'robot_base'")])
def test_a_view_without_the_robot_s_place_is_skipped(tmp_path, config, left_out, reason, said):
    read = BagViews(bag(tmp_path / "bag", **{left_out: False}), config)
    assert not list(read) and read.assembler.tally.skipped == {reason: 6}
    assert said in read.assembler.last_errors[0]


def test_a_world_frame_on_the_robot_needs_no_tf(tmp_path, config):
    moved = [replace(v, T_world_camera=geometry.inverse(T_WORLD_BASE) @ v.T_world_camera)
             for v in scan()]
    out = records(moved, poses=False)
    for i, view in enumerate(moved):
        out.append(joint_record(view.stamp_ns, positions(i)))
        out.append(tf_record(view.stamp_ns, view.T_world_camera, FRAME, "robot_base"))
    read = BagViews(write(tmp_path / "bag", out), replace(config, world_frame="robot_base"))
    assert len(list(read)) == 6


def test_a_urdf_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match="no URDF /nowhere.urdf"):
        BagViews(bag(tmp_path / "bag"), CollectorConfig(robot_description_file="/nowhere.urdf"))
