# SPDX-License-Identifier: Apache-2.0
"""Scenes whose z is not up are turned by the support that their depth shows."""

import json
from dataclasses import replace

import numpy as np
import pytest
from kits import users_recordings as users
from kits.recording_kit import SMALL, scan
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.bag.bag_views import BagViews
from stack_counter.bag.nerfstudio import import_scene
from stack_counter.config import CollectorConfig
from stack_counter.fusion.upright import find_turn


@pytest.mark.parametrize("degrees", [0, 3, 40, 90, 180])
def test_a_scene_is_turned_so_that_its_support_is_level(tmp_path, degrees):
    scene = users.folder(tmp_path / "scene", depth_file_path="depths/{}.png")
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler("x", -degrees, degrees=True).as_matrix()
    document = json.loads((scene / "transforms.json").read_text())
    for frame in document["frames"]:
        frame["transform_matrix"] = (turned @ frame["transform_matrix"]).tolist()
    (scene / "transforms.json").write_text(json.dumps(document))
    said = import_scene(scene, tmp_path / "out")
    assert (f"turned by {degrees}.0 degrees" in said) == (degrees > 0)
    for (_, view), truth in zip(BagViews(tmp_path / "out", CollectorConfig()), scan()):
        up = view.T_world_camera[:3, :3].T @ [0, 0, 1]
        assert up == pytest.approx(truth.T_world_camera[:3, :3].T @ [0, 0, 1], abs=0.01)


def test_nothing_is_turned_without_a_support_or_by_a_wall():
    assert np.array_equal(find_turn([]), np.eye(4))
    assert np.array_equal(find_turn(replace(view, depth=0 * view.depth) for view in scan()),
                          np.eye(4))
    walls = []  # the plane y = 0 alone, seen by cameras that look down
    for x in (-0.1, 0.0, 0.1):
        T = geometry.look_at(np.array([x, -0.5, 0.5]), np.zeros(3))
        forward = geometry.pixel_rays(SMALL, dtype=np.float64) @ T[:3, :3].T
        walls.append(replace(scan()[0], T_world_camera=T,
                             depth=(0.5 / forward[..., 1]).astype(np.float32)))
    assert np.array_equal(find_turn(walls), np.eye(4))
