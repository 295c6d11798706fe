# SPDX-License-Identifier: Apache-2.0
"""The robot's pixels against closed forms of the same arm, and what a URDF may say."""

import numpy as np
import pytest
from kits.analytic import Scene
from kits.robot import ARM_HEIGHT, ARM_LENGTH, URDF, add_arm, write_urdf

from stack_counter import geometry
from stack_counter.errors import ConfigError, ViewError
from stack_counter.types import Intrinsics
from stack_counter.views.robot_mask import SETTINGS, RobotMask

CAMERA = Intrinsics(320, 240, 260.0, 260.0, 159.5, 119.5)
ABOVE = geometry.look_at(np.array([0.3, 0.1, 0.9]), np.array([0.3, 0.0, 0.0]))
T_WORLD_BASE = geometry.pose(np.eye(3), np.array([0.0, -0.1, 0.0]))


def arm_scene(turn, slide, plane=True):
    return add_arm(Scene(plane), T_WORLD_BASE, turn, slide)


@pytest.fixture(scope="module")
def mask(tmp_path_factory):
    return RobotMask(write_urdf(tmp_path_factory.mktemp("robot")))


@pytest.mark.parametrize("turn, slide", [(0.0, 0.0), (0.7, 0.15), (-1.2, 0.3)])
def test_all_of_the_robot_is_left_out_and_little_else(mask, turn, slide):
    view = arm_scene(turn, slide).view(ABOVE, CAMERA)
    robot = arm_scene(turn, slide, plane=False).view(ABOVE, CAMERA).depth > 0
    assert 0.02 < robot.mean() < 0.3
    depth = mask.depth_without_robot(view, T_WORLD_BASE, {"shoulder": turn, "slide": slide})
    assert not depth[robot].any()
    # Farther from it than twice the margin at the nearest distance, nothing is touched.
    reach = int(np.ceil(2.9 * SETTINGS.margin_m * CAMERA.fx / 0.45))
    far = ~np.lib.stride_tricks.sliding_window_view(
        np.pad(robot, reach), (2 * reach + 1, 2 * reach + 1)).any(axis=(2, 3))
    np.testing.assert_array_equal(depth[far], view.depth[far])
    assert far.mean() > 0.3


def test_a_robot_that_is_not_where_it_should_be_is_noticed(mask):
    """By a wrong base, or by joint states of another time: its pixels would count as parts."""
    view = arm_scene(0.0, 0.1).view(ABOVE, CAMERA)
    for turn, slide, aside in ((0.6, 0.1, 0.0), (0.0, 0.1, 0.15)):
        T = geometry.pose(np.eye(3), T_WORLD_BASE[:3, 3] + [0, aside, 0])
        with pytest.raises(ViewError, match="pixels where the robot should be show") as raised:
            mask.depth_without_robot(view, T, {"shoulder": turn, "slide": slide})
        assert raised.value.reason == "robot_misplaced"
    # What a calibration is off by, here 5 mm at the hand, is within the margin.
    depth = mask.depth_without_robot(view, T_WORLD_BASE, {"shoulder": 0.01, "slide": 0.1})
    assert not depth[arm_scene(0.0, 0.1, plane=False).view(ABOVE, CAMERA).depth > 0].any()


def test_what_lies_in_front_of_the_robot_stays(mask):
    """A box between camera and arm hides the arm."""
    view = arm_scene(0.0, 0.0).box((0.3, 0.0, 0.6), (0.2, 0.2, 0.02)).view(ABOVE, CAMERA)
    depth = mask.depth_without_robot(view, T_WORLD_BASE, {"shoulder": 0.0, "slide": 0.0})
    box = view.depth < 0.35
    assert box.sum() > 1000
    np.testing.assert_array_equal(depth[box], view.depth[box])


def test_a_robot_out_of_sight_changes_nothing(mask):
    view = Scene().view(ABOVE, CAMERA)
    away = geometry.pose(np.eye(3), np.array([5.0, 0, 0]))
    depth = mask.depth_without_robot(view, away, {"shoulder": 0.0, "slide": 0.0})
    np.testing.assert_array_equal(depth, view.depth)


def test_the_camera_s_own_housing_hides_nothing(mask):
    """Here the camera sits inside the hand, which is 30 mm around it."""
    T = mask.link_pose("hand", {"shoulder": 0.0, "slide": 0.0})
    down = geometry.pose(np.diag([1.0, -1, -1]), (T_WORLD_BASE @ T)[:3, 3])
    view = Scene().view(down, CAMERA)
    depth = mask.depth_without_robot(view, T_WORLD_BASE, {"shoulder": 0.0, "slide": 0.0})
    np.testing.assert_array_equal(depth, view.depth)


def test_links_are_where_their_joints_put_them(mask):
    assert mask.base_link == "robot_base" and set(mask.joint_names) == {"shoulder", "slide"}
    assert mask.has_link("tool0") and not mask.has_link("base_link")
    T = mask.link_pose("tool0", {"shoulder": np.pi / 2, "slide": 0.1})
    np.testing.assert_allclose(T[:3, 3], [0, ARM_LENGTH, ARM_HEIGHT - 0.1 - 0.05], atol=1e-9)


@pytest.mark.parametrize("mesh", ["../meshes/ball.stl", "file://{folder}/meshes/ball.stl",
                                  "package://arm_description/meshes/ball.stl"])
def test_meshes_are_found_by_package_file_or_path(tmp_path, mesh):
    path = write_urdf(tmp_path, mesh.format(folder=tmp_path / "arm_description"))
    assert RobotMask(path).base_link == "robot_base"


def test_a_package_elsewhere_is_found_by_the_ament_prefix_path(tmp_path, monkeypatch):
    write_urdf(tmp_path / "install" / "share")
    alone = tmp_path / "arm.urdf"
    alone.write_text(URDF.replace("MESH", "package://arm_description/meshes/ball.stl"))
    with pytest.raises(ConfigError, match="no mesh package://arm_description.*AMENT_PREFIX_PATH"):
        RobotMask(alone)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'install'}")
    assert RobotMask(alone).base_link == "robot_base"


@pytest.mark.parametrize("suffix, said", [
    (".stl", "or a mesh of it, cannot be read"), (".obj", "no triangles in a mesh"),
    (".dae", "or a mesh of it, cannot be read")])
def test_a_mesh_that_is_none_is_refused(tmp_path, suffix, said):
    path = write_urdf(tmp_path, f"../meshes/none{suffix}")
    (tmp_path / "arm_description" / "meshes" / f"none{suffix}").write_text("v 0 0 0\n")
    with pytest.raises(ConfigError, match=said):
        RobotMask(path)


@pytest.mark.parametrize("text, said", [
    (None, "no URDF .*expected the file that robot_description_file names"),
    ("no xml", "or a mesh of it, cannot be read .*; expected URDF"),
    ("<robot name='a'><link name='b'/></robot>", "no triangles in any link"),
    (URDF.replace("prismatic", "floating"), "joint slide \\(floating\\); expected one of")])
def test_what_cannot_be_used_is_refused(tmp_path, text, said):
    path = tmp_path / "arm.urdf"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=said) as raised:
        RobotMask(path)
    assert "\n" not in str(raised.value)
