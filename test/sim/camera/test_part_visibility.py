# SPDX-License-Identifier: Apache-2.0
"""Which parts a camera sees, against closed forms; the key view as a picture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from kits.single_part import one_part

from stack_counter import geometry
from stack_counter.sim import SceneError, picture_key_view, read_scenes
from stack_counter.sim.camera.part_visibility import find_parts_in_view
from stack_counter.sim.camera.recording import scaled_camera
from stack_counter.sim.camera.render import Renderer

DATA = Path(__file__).parents[3] / "data" / "train-deep"
SMALL = scaled_camera(160)


def plates(*positions):
    """Plates of 40 x 40 x 2 mm."""
    scene = one_part(trimesh.creation.box([0.04, 0.04, 0.002]), 0.001)
    poses = np.array([[*p, 0, 0, 0, 1] for p in positions], float)
    return replace(scene, poses=poses)


def seen_from_above(scene, intrinsics=scaled_camera(640)):
    T = geometry.look_at(np.array([0.0, 0, 1.0]), np.zeros(3))
    return find_parts_in_view(Renderer(scene), scene, intrinsics, T)


def test_a_part_shows_what_others_leave_of_its_outline():
    # The second lies on a quarter of the first, the fourth fully below the third.
    seen = seen_from_above(plates([0, 0, 0.001], [0.02, 0.02, 0.003], [0.1, 0, 0.003],
                                  [0.1, 0, 0.001]))
    np.testing.assert_allclose(seen.shares, [0.75, 1, 1, 0], atol=0.03)
    assert set(np.unique(seen.numbers)) == {-1, 0, 1, 2}
    assert seen.visible.tolist() == [1, 2, 0]


def test_boxes_and_centers_are_those_of_the_pixels_in_a_crop_too():
    seen = seen_from_above(plates([0.1, 0, 0.001], [-0.1, 0, 0.001]))
    size = 610 * 0.04 / 0.998
    boxes, centers = seen.boxes(np.array([0, 1])), seen.centers(np.array([0, 1]))
    np.testing.assert_allclose(boxes[:, 2:] - boxes[:, :2] + 1, size, atol=1.1)
    np.testing.assert_allclose(centers, (boxes[:, :2] + boxes[:, 2:]) / 2, atol=0.6)
    crop = seen.cropped(slice(30, 400), slice(20, 600))
    np.testing.assert_allclose(crop.boxes(np.array([0])), boxes[:1] - [20, 30, 20, 30])
    assert np.isnan(crop.boxes(np.array([7]))).all()


def test_what_is_outside_the_picture_does_not_show():
    seen = seen_from_above(plates([0, 0, 0.001], [3, 0, 0.001]))
    assert seen.shares.tolist() == [1, 0]


def test_the_key_view_is_cropped_to_the_parts_and_always_the_same():
    scene = next(iter(read_scenes(DATA, 1)))
    first, again = (picture_key_view(scene, 3, intrinsics=SMALL) for _ in range(2))
    assert first.color.shape == (*first.parts.numbers.shape, 3)
    edges = [first.parts.numbers[0], first.parts.numbers[-1], first.parts.numbers[:, 0],
             first.parts.numbers[:, -1]]
    assert all((edge >= 0).any() for edge in edges)
    assert 12 < first.visible_count < scene.truth.count
    np.testing.assert_array_equal(first.color, again.color)


def test_an_empty_scene_has_no_key_view():
    scene = next(iter(read_scenes(DATA, 1)))
    with pytest.raises(SceneError, match="holds no part"):
        picture_key_view(replace(scene, poses=np.zeros((0, 7))), 2, intrinsics=SMALL)
