# SPDX-License-Identifier: Apache-2.0
"""The simulator's camera against closed forms, and its recordings."""

import numpy as np
import pytest
import trimesh
from kits.analytic import Scene as Analytic
from scipy import ndimage

from stack_counter import geometry
from stack_counter.sim import Scene, record
from stack_counter.sim.camera.depth_camera import DepthCamera, perturb_pose
from stack_counter.sim.camera.recording import CAMERA
from stack_counter.sim.camera.render import Renderer, camera_rays
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.shapes import Shape
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, Intrinsics

HEAP = ContainerShape("none", inner_size_m=(1.0, 1.0, 0.0))


def one_part(mesh, z, container=HEAP):
    """A scene of a single part above the middle of the container's bottom."""
    shape = Shape("test", np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32))
    return Scene(0, 0, shape, container, np.array([[0, 0, z, 0, 0, 0, 1.0]]))


SOLIDS = {
    "box": (trimesh.creation.box([0.1, 0.06, 0.04]), 0.02,
            Analytic().box([0, 0, 0.02], [0.1, 0.06, 0.04])),
    "ball": (trimesh.creation.icosphere(5, 0.05), 0.05, Analytic().sphere([0, 0, 0.05], 0.05)),
    "cylinder": (trimesh.creation.cylinder(0.04, 0.06, sections=720), 0.03,
                 Analytic().cylinder(0, 0, 0.04, 0.06)),
}


def away_from_edges(depth):
    steps = np.abs(np.gradient(depth)).max(axis=0) > 0.01
    return ~ndimage.binary_dilation(steps, iterations=2)


@pytest.mark.parametrize("name", SOLIDS)
def test_depth_is_that_of_the_closed_form(name):
    mesh, z, analytic = SOLIDS[name]
    T = geometry.look_at(np.array([0.2, -0.15, 0.5]), np.array([0.0, 0, 0.02]))
    depth, labels = Renderer(one_part(mesh, z)).render_depth_and_labels(CAMERA, T)
    want = analytic.view(T).depth
    assert np.abs(depth - want)[away_from_edges(want)].max() < 1e-4
    # Pixel centres: the outline's middle lies where the closed form has it.
    plane = Analytic().view(T).depth
    middle = [np.array(ndimage.center_of_mass(x)) for x in (labels == PARTS, want < plane - 1e-5)]
    assert np.abs(middle[0] - middle[1]).max() < 0.1


def test_a_filled_bin_is_seen_where_it_stands():
    c, s = np.cos(0.4), np.sin(0.4)
    pose = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([0.05, -0.02, 0]))
    box = ContainerShape("bin", pose, (0.2, 0.14, 0.1), 0.01, 0.008)
    scene = one_part(trimesh.creation.box([0.2, 0.14, 0.06]), 0.008 + 0.03, box)
    T = geometry.look_at(np.array([0.25, -0.1, 0.6]), np.array([0.05, -0.02, 0.05]))
    depth, labels = Renderer(scene).render_depth_and_labels(CAMERA, T)
    want = Analytic().bin((0.2, 0.14, 0.1), 0.01, 0.008, 0.06, 0.05, -0.02, 0.4).view(T).depth
    assert np.abs(depth - want)[away_from_edges(want)].max() < 1e-4
    assert set(np.unique(labels)) == {BACKGROUND, CONTAINER, PARTS}
    # The parts' top, 0.2 x 0.14 m, is cut by the wall's edge: what shows of it has its height.
    direction = camera_rays(CAMERA, T)[..., 3:][labels == PARTS]
    height = T[2, 3] + depth[labels == PARTS] * direction[:, 2]
    np.testing.assert_allclose(height, 0.068, atol=1e-4)


@pytest.mark.parametrize("z", [0.4, 0.6, 0.9])
def test_noise_grows_as_the_model_says(z):
    k = Intrinsics(400, 400, 610.0, 610.0, 199.5, 199.5)
    camera = DepthCamera()
    got = camera.measure(np.full((400, 400), z, np.float32), k, np.random.default_rng(1))
    assert (got > 0).all()
    want = np.hypot(camera.sigma_m + camera.sigma_per_m2 * (z - 0.4) ** 2,
                    camera.step_m / 12**0.5)
    assert np.std(got - z) == pytest.approx(want, rel=0.1)
    np.testing.assert_allclose(got / 0.001, np.round(got / 0.001), atol=1e-3)


def test_depth_is_torn_at_edges():
    depth = np.full((50, 50), 0.6, np.float32)
    depth[:, 25:] = 0.5
    got = DepthCamera().measure(depth, Intrinsics(50, 50, 600.0, 600.0, 25.0, 25.0),
                                np.random.default_rng(0))
    assert (got[:, 24] == 0).all() and (got[5:-5, 5:20] > 0).all()


def test_pose_noise_has_its_size():
    random = np.random.default_rng(0)
    T = geometry.look_at(np.array([0.3, 0.1, 0.5]), np.zeros(3))
    changes = np.array([geometry.pose_change(T, perturb_pose(T, random)) for _ in range(400)])
    # The norm of three normal errors has a root mean square of sqrt(3) times theirs.
    rms = np.sqrt((changes**2).mean(axis=0))
    assert rms == pytest.approx([3**0.5 * 0.0005, 3**0.5 * np.deg2rad(0.05)], rel=0.1)


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
