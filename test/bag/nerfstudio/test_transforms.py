# SPDX-License-Identifier: Apache-2.0
"""Poses and calibrations as nerfstudio, Instant NGP and Blender write them."""

import numpy as np
import pytest
from kits.nerfstudio import FLIP

from stack_counter.bag.nerfstudio.transforms import (
    depth_unit,
    position_scale,
    read_frames,
    read_intrinsics,
    read_pose,
)
from stack_counter.errors import BagError

FRAME = {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist(), "fl_x": 500.0,
         "fl_y": 501.0, "cx": 319.0, "cy": 239.0, "w": 640, "h": 480}


@pytest.mark.parametrize("kind", ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL",
                                  "RADIAL"])
def test_perspective_models_are_read(kind):
    k = read_intrinsics({**FRAME, "camera_model": kind, "k1": 0.1, "p1": 0.01}, 640, 480)
    assert (k.fx, k.fy, k.cx, k.cy) == (500, 501, 319, 239)
    assert (k.distortion_model, k.distortion) == ("plumb_bob", (0.1, 0, 0.01, 0, 0))


@pytest.mark.parametrize("keys", [
    {"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True, "camera_model": "OPENCV"}])
def test_fisheye_lenses_have_four_coefficients(keys):
    k = read_intrinsics({**FRAME, "k1": 0.1, "k4": 0.4, **keys}, 640, 480)
    assert (k.distortion_model, k.distortion) == ("equidistant", (0.1, 0, 0, 0.4))


def test_listed_coefficients_are_in_nerfstudios_order():
    k = read_intrinsics({**FRAME, "distortion_params": [1, 2, 3, 0, 5, 6]}, 640, 480)
    assert k.distortion == (1, 2, 5, 6, 3)  # OpenCV: k1 k2 p1 p2 k3


@pytest.mark.parametrize("keys, fx, fy", [
    ({"camera_angle_x": np.pi / 2}, 320, 320),
    ({"camera_angle_x": np.pi / 2, "camera_angle_y": np.pi / 2}, 320, 240),
    ({"x_fov": 90.0}, 320, 320),
    ({"fl_x": 700}, 700, 700)])
def test_an_angle_of_view_gives_the_focal_length(keys, fx, fy):
    k = read_intrinsics({"file_path": "a", **keys}, 640, 480)
    assert (k.fx, k.fy) == pytest.approx((fx, fy))
    assert (k.width, k.height, k.cx, k.cy) == (640, 480, 319.5, 239.5)


@pytest.mark.parametrize("keys, point", [
    ({}, (319, 239)), ({"cx": 320.0, "cy": 240.0}, (319.5, 239.5)),
    ({"cx": 319.5, "cy": 239.5}, (319.5, 239.5)), ({"colmap_im_id": 1}, (318.5, 238.5)),
    ({"sharpness": 90.0}, (318.5, 238.5))])
def test_a_principal_point_is_between_whole_pixels_whatever_tool_has_written_it(keys, point):
    k = read_intrinsics({**FRAME, **keys}, 640, 480)
    assert (k.cx, k.cy) == point


@pytest.mark.parametrize("keys, said", [
    ({"camera_model": "EQUIRECTANGULAR"}, "'EQUIRECTANGULAR', which is no lens"),
    ({"camera_model": "FISHEYE624"}, "'FISHEYE624'"),
    ({"w": 1280, "h": 960}, "a.jpg is 640x480 and transforms.json says 1280x960"),
    ({"k4": 0.1}, "k4 is 0.1 with a perspective"),
    ({"fl_x": 0, "fl_y": 0}, "lacks fl_x; expected it, or camera_angle_x"),
    ({"fl_x": "wide"}, "calibration is malformed"), ({"fl_x": 10**400}, "int too large"),
    ({"w": float("inf")}, "w or h of a.jpg is malformed")])
def test_bad_calibrations_are_named(keys, said):
    with pytest.raises(BagError, match=said):
        read_intrinsics({**FRAME, **keys}, 640, 480)


def test_an_applied_scale_is_undone_and_rigid_transforms_stay():
    T = np.eye(4)
    T[:3, 3] = 1, 2, 3
    turned = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]  # as ns-process-data turns COLMAP's
    pose = {**FRAME, "transform_matrix": T.tolist(), "applied_transform": turned}
    assert np.allclose(read_pose(pose), T @ FLIP)
    assert np.allclose(read_pose({**pose, "applied_scale": 2.0})[:3, 3], (0.5, 1, 1.5))
    doubled = (2 * np.array(turned)).tolist()
    assert position_scale({"applied_transform": doubled}) == pytest.approx(2)
    assert np.allclose(read_pose({**FRAME, "transform_matrix": T[:3].tolist()}), T @ FLIP)


@pytest.mark.parametrize("keys, said", [
    ({"transform_matrix": [[1, 0], [0, 1]]}, "lacks a finite transform_matrix"),
    ({"transform_matrix": np.full((4, 4), np.nan).tolist()}, "lacks a finite"),
    ({"transform_matrix": np.diag([2.0, 2, 2, 1]).tolist()}, "off a rotation by 3"),
    ({"transform_matrix": np.diag([1.0, 1, -1, 1]).tolist()}, "expected right-handed axes"),
    ({"transform_matrix": [[10**400] * 4] * 4}, "lacks int too large"),
    ({"applied_scale": 0}, "scale positions by 0.0; expected"),
    ({"applied_scale": 10**400}, "malformed"),
    ({"applied_scale": "half"}, "malformed")])
def test_bad_poses_are_named(keys, said):
    with pytest.raises(BagError, match=said):
        read_pose({**FRAME, **keys})


def test_a_unit_of_depth_beyond_all_numbers_is_named():
    with pytest.raises(BagError, match="expected metres in one step"):
        depth_unit({"depth_unit_scale_factor": 10**400})


def test_a_file_nested_too_deeply_is_malformed(tmp_path):
    (tmp_path / "transforms.json").write_text('{"frames": ' + "[" * 100_000)
    with pytest.raises(BagError, match="malformed at maximum recursion"):
        read_frames(tmp_path)
