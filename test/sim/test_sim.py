"""The simulator against closed forms; its physics where the engine has a wheel."""

import numpy as np
import pytest
import trimesh
from analytic import Scene as Analytic
from scipy import ndimage

from stack_counter import geometry
from stack_counter.sim import Scene, load_scene, record, truth_of
from stack_counter.sim.camera import DepthCamera, noisy_pose
from stack_counter.sim.recording import CAMERA
from stack_counter.sim.render import Renderer
from stack_counter.sim.scene import SceneError
from stack_counter.sim.shapes import FAMILIES, Shape, ShapeError, make_shape
from stack_counter.types import CONTAINER, PARTS, Container, Intrinsics


def one_part(mesh, z, container=None):
    """A scene of a single part above the plane's origin."""
    shape = Shape("test", np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32))
    return Scene(0, 0, shape, container or Container("none", np.eye(4)),
                 np.array([[0, 0, z, 0, 0, 0, 1]], np.float32))


SOLIDS = {
    "box": (trimesh.creation.box([0.1, 0.06, 0.04]), 0.02,
            Analytic().box([0, 0, 0.02], [0.1, 0.06, 0.04])),
    "ball": (trimesh.creation.icosphere(5, 0.05), 0.05, Analytic().sphere([0, 0, 0.05], 0.05)),
    "cylinder": (trimesh.creation.cylinder(0.04, 0.06, sections=720), 0.03,
                 Analytic().cylinder(0, 0, 0.04, 0.06)),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_depth_is_that_of_the_closed_form(name):
    mesh, z, analytic = SOLIDS[name]
    T = geometry.look_at(np.array([0.2, -0.15, 0.5]), np.array([0.0, 0, 0.02]))
    depth, labels = Renderer(one_part(mesh, z)).depth_and_labels(CAMERA, T)
    want = analytic.view(T).depth
    inside = ~ndimage.binary_dilation(np.abs(np.gradient(want)[0]) > 0.01, iterations=2) \
        & ~ndimage.binary_dilation(np.abs(np.gradient(want)[1]) > 0.01, iterations=2)
    assert np.abs(depth - want)[inside].max() < 1e-4
    # Pixel centres: the outline's middle lies where the closed form has it.
    plane = Analytic().view(T).depth
    middle = [np.array(ndimage.center_of_mass(x)) for x in (labels == PARTS, want < plane - 1e-5)]
    assert np.abs(middle[0] - middle[1]).max() < 0.1


def test_truth_of_a_full_box_is_its_volume():
    inner, floor = (0.2, 0.14, 0.1), 0.004
    box = Container("box", geometry.look_at(np.zeros(3), np.array([0, 0, 1.0])), inner, 0.003,
                    floor)
    filling = trimesh.creation.box([0.2, 0.14, 0.08])
    truth = truth_of(one_part(filling, floor + 0.04, Container(
        "box", np.eye(4), box.inner_size_m, 0.003, floor)))
    assert truth.stack_volume == pytest.approx(0.2 * 0.14 * 0.08, rel=0.005)
    assert truth.gamma == pytest.approx(1, rel=0.005) and truth.count == 1


def test_truth_of_a_ball_on_the_plane_fills_its_undercut():
    ball = trimesh.creation.icosphere(5, 0.05)
    want = 4 / 6 * np.pi * 0.05**3 + np.pi * 0.05**3  # upper half, and the cylinder below it
    # 20 cells across are a coarse circle.
    assert truth_of(one_part(ball, 0.05)).stack_volume == pytest.approx(want, rel=0.01)


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_gives_one_solid(family):
    for seed in range(3):
        shape = make_shape(seed, family)
        assert shape.mesh.is_watertight and shape.unit_volume > 0
        assert 0.0149 < shape.part_size < 0.0451 and 0 < shape.convexity <= 1.0001
        np.testing.assert_array_equal(shape.vertices, make_shape(seed, family).vertices)
    with pytest.raises(ShapeError, match="unknown family"):
        make_shape(0, "banana")


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
    changes = np.array([geometry.pose_change(T, noisy_pose(T, random)) for _ in range(400)])
    # The norm of three normal errors has a root mean square of sqrt(3) times theirs.
    rms = np.sqrt((changes**2).mean(axis=0))
    assert rms == pytest.approx([3**0.5 * 0.0005, 3**0.5 * np.deg2rad(0.05)], rel=0.1)


def test_scene_survives_its_file_and_damage_is_refused(tmp_path):
    scene = one_part(trimesh.creation.box([0.1, 0.06, 0.04]), 0.02)
    scene.save(tmp_path / "s.npz")
    back = load_scene(tmp_path / "s.npz")
    np.testing.assert_array_equal(back.poses, scene.poses)
    assert truth_of(back) == truth_of(scene)
    (tmp_path / "cut.npz").write_bytes((tmp_path / "s.npz").read_bytes()[:-100])
    with pytest.raises(SceneError, match="no whole scene"):
        load_scene(tmp_path / "cut.npz")


def test_recording_sees_container_and_parts_and_hides_the_true_pose():
    box = Container("box", np.eye(4), (0.2, 0.14, 0.1), 0.004, 0.004)
    scene = one_part(trimesh.creation.box([0.19, 0.13, 0.06]), 0.034, box)
    views = record(scene, views=3, seed=1, color=False)
    again = record(scene, views=3, seed=1, color=False)
    for view, same in zip(views, again):
        np.testing.assert_array_equal(view.depth, same.depth)
        labels = Renderer(scene).depth_and_labels(CAMERA, view.T_world_camera)[1]
        assert {CONTAINER, PARTS} <= set(np.unique(labels))
        assert not (labels[[0, -1]] == PARTS).any(), "the parts are in view whole"


def test_a_small_pile_comes_to_rest():
    pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")
    from stack_counter.sim.piles import Plan, drop

    shape = make_shape(3, "nut")
    plan = Plan(shape, np.array([5.0, 5.0, 4.0]), 0.1, 0.1, 0.5, 0.4, 0.1)
    scene = drop(plan, np.random.default_rng(0), 0, 0)
    truth = truth_of(scene)
    assert truth.count >= 20 and 0.2 < truth.gamma < 0.7
    local = geometry.apply(geometry.inverse(scene.container.T_world_container),
                           scene.parts_mesh().vertices.astype(float))
    half = np.array(scene.container.inner_size_m[:2]) / 2
    assert (np.abs(local[:, :2]) - half).max() < 0.03 * shape.part_size, "walls hold the parts"
    assert local[:, 2].min() > scene.container.floor_thickness_m - 0.03 * shape.part_size
