# SPDX-License-Identifier: Apache-2.0
"""Recordings of simulated scenes."""

import numpy as np
import pytest
import trimesh
from kits.single_part import HEAP, one_part

from stack_counter import geometry
from stack_counter.sim import record, record_returning_camera
from stack_counter.sim.camera.recording import CAMERA
from stack_counter.sim.camera.render import Renderer
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.types import CONTAINER, PARTS


@pytest.mark.parametrize("kind", ["bin", "bag", "none"])
def test_recording_sees_the_parts_whole_and_is_the_same_for_a_seed(kind):
    container = HEAP if kind == "none" else ContainerShape(
        kind, inner_size_m=(0.2, 0.14, 0.1), wall_thickness_m=0.004, floor_thickness_m=0.004)
    scene = one_part(trimesh.creation.box([0.15, 0.1, 0.06]), 0.034, container)
    views = record(scene, views=3, seed=1, color=False)
    again = record(scene, views=3, seed=1, color=False)
    for view, same in zip(views, again):
        np.testing.assert_array_equal(view.depth, same.depth)
        np.testing.assert_array_equal(view.T_world_camera, same.T_world_camera)
        labels = Renderer(scene).render_depth_and_labels(CAMERA, view.T_world_camera)[1]
        assert {PARTS} | ({CONTAINER} if kind != "none" else set()) <= set(np.unique(labels))
        assert not (labels[[0, -1]] == PARTS).any() and not (labels[:, [0, -1]] == PARTS).any()
    assert (record(scene, views=1, seed=2, color=False)[0].depth != views[0].depth).any()


def test_a_returning_camera_goes_back_and_forth_and_reports_another_pose_each_time():
    scene = one_part(trimesh.creation.box([0.15, 0.1, 0.06]), 0.034, HEAP)
    views = record_returning_camera([scene] * 5, color=False)
    distance = np.array([[geometry.pose_change(a.T_world_camera, b.T_world_camera)[0]
                          for a in views] for b in views])
    back = np.add.outer(range(5), range(5)) % 2 == 0
    assert distance[~back].min() > 0.1 and distance[back].max() < 0.005
    assert (distance[~np.eye(5, dtype=bool)] > 0).all() and not any(v.fixed for v in views)
