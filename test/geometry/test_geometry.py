# SPDX-License-Identifier: Apache-2.0
import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.types import UNSEEN, Intrinsics, View

RANDOM = np.random.default_rng(0)
ROTATIONS = Rotation.random(50, random_state=0).as_matrix()
K = Intrinsics(64, 48, 60.0, 62.0, 31.0, 24.0)


def test_inverse_and_quaternions_against_scipy():
    for R in ROTATIONS:
        T = geometry.pose(R, RANDOM.normal(size=3))
        np.testing.assert_allclose(T @ geometry.inverse(T), np.eye(4), atol=1e-12)
        q = geometry.quaternion_from_pose(T)
        want = Rotation.from_matrix(R).as_quat(canonical=True)
        np.testing.assert_allclose(q, want, atol=1e-9)
        np.testing.assert_allclose(geometry.pose_from_quaternion(q, T[:3, 3]), T, atol=1e-12)


def test_a_canonical_pose_survives_its_quaternion_bit_by_bit():
    random = np.random.default_rng(0)
    equal = [(1, 1, 1, 1), (1, -1, 1, -1), (1, 1, 0, 0), (0, 0, 1, 1), (1, 0, 0, 0)]
    quaternions = np.concatenate([np.array(equal, float), random.normal(size=(2000, 4))])
    for q in quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True):
        raw = geometry.pose(Rotation.from_quat(q).as_matrix(), random.normal(size=3))
        T = geometry.canonical_pose(raw)
        np.testing.assert_array_equal(geometry.canonical_pose(T), T)
        np.testing.assert_allclose(T, raw, atol=1e-13)


def test_projection_inverts_unprojection_and_agrees_with_opencv():
    depth = RANDOM.uniform(0.3, 1.0, (48, 64)).astype(np.float32)
    points = geometry.unproject(depth, K)
    pixels, z = geometry.project(points, K)
    v, u = np.mgrid[:48, :64]
    np.testing.assert_allclose(pixels, np.stack([u, v], -1), atol=1e-4)
    np.testing.assert_allclose(z, depth)
    want, _ = cv2.projectPoints(points.reshape(-1, 3).astype(float), np.zeros(3), np.zeros(3),
                                K.K, None)
    np.testing.assert_allclose(pixels.reshape(-1, 2), want[:, 0], atol=1e-4)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_points_fall_into_the_pixels_that_they_were_made_of(dtype):
    depth = RANDOM.uniform(0.3, 1.0, (48, 64)).astype(np.float32)
    depth[5, 7] = 0
    view = View(0, K, geometry.pose(ROTATIONS[0], np.array([0.1, -0.2, 0.3])), depth=depth)
    points = geometry.world_points(view).reshape(-1, 3)
    found = geometry.project_into(view, points, dtype)
    rows, cols = np.nonzero(depth)
    np.testing.assert_array_equal(found.inside, depth.ravel() > 0)
    np.testing.assert_array_equal([found.rows, found.cols], [rows, cols])
    np.testing.assert_allclose(found.depth, depth[rows, cols], rtol=1e-5)


def test_points_behind_and_beside_the_image_are_outside():
    view = View(0, K, np.eye(4))
    x = np.array([-31.4, -31.6, 32.4, 32.6]) / 60  # K's columns end at -0.5 and 63.5
    points = np.concatenate([np.stack([x, 0 * x, 0 * x + 1], 1), [[0, 0, -1.0], [0, 0, 0]]])
    found = geometry.project_into(view, points)
    np.testing.assert_array_equal(found.inside, [True, False, True, False, False, False])
    np.testing.assert_array_equal(found.cols, [0, 63])
    np.testing.assert_array_equal(found.rows, [24, 24])


def test_every_third_pixel_and_its_ray():
    depth = RANDOM.uniform(0.3, 1.0, (48, 64)).astype(np.float32)
    view = View(0, K, geometry.pose(ROTATIONS[1], np.ones(3)), depth=depth)
    np.testing.assert_array_equal(geometry.world_points(view, 3),
                                  geometry.world_points(view)[::3, ::3])
    rays = geometry.pixel_rays(K, 3, np.float64)
    np.testing.assert_allclose(rays * depth[::3, ::3, None], geometry.unproject(depth, K, 3),
                               atol=1e-6)
    with pytest.raises(ViewError, match="no_depth"):
        geometry.world_points(View(0, K, np.eye(4)))


def test_rays_through_a_point_meet_in_it():
    point = np.array([0.3, -0.1, 0.2])
    origins = RANDOM.normal(size=(6, 3))
    ways = (point - origins) / np.linalg.norm(point - origins, axis=1)[:, None]
    np.testing.assert_allclose(geometry.nearest_point_to_rays(origins, ways), point, atol=1e-12)
    # Two skew lines: the middle of their common perpendicular.
    across = geometry.nearest_point_to_rays(np.array([[0, 0, 0], [0, 0, 2.0]]),
                                            np.array([[1.0, 0, 0], [0, 1, 0]]))
    np.testing.assert_allclose(across, [0, 0, 1], atol=1e-12)
    with pytest.raises(ScanError, match="several sides"):
        geometry.nearest_point_to_rays(origins, np.tile([0, 0, 1.0], (6, 1)))


def test_look_at_puts_the_target_on_the_axis_and_up_upwards():
    T = geometry.look_at(np.array([0.4, -0.3, 0.6]), np.array([0.1, 0.1, 0.0]))
    pixel, z = geometry.project(geometry.apply(geometry.inverse(T), np.array([0.1, 0.1, 0])), K)
    np.testing.assert_allclose(pixel, [K.cx, K.cy], atol=1e-9)
    assert z > 0 and T[2, 1] < 0  # image y points down
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)


RADIAL = (0.1, -0.05, 0.002, -0.001, 0.01)
RATIONAL = (0.3, 0.1, 0.002, -0.001, 0.02, 0.25, 0.12, 0.01)
PRISM = (*RATIONAL, 0.02, -0.01, -0.03, 0.01)


@pytest.mark.parametrize("model, coefficients", [
    ("plumb_bob", RADIAL), ("plumb_bob", RADIAL[:4]), ("rational_polynomial", RATIONAL),
    ("plumb_bob", RATIONAL),  # as some drivers call it
    ("rational_polynomial", PRISM), ("thin_prism", PRISM),
    ("rational_polynomial", (*PRISM, 0.02, -0.03)),
    ("radtan", RADIAL), ("Brown Conrady", RADIAL), ("kannala_brandt", (0.05, -0.01, 0.002, 0.0)),
    ("equidistant", (0.05, -0.01, 0.002, 0.0)), ("fisheye", (0.05, -0.01, 0.002, 0.01)),
    ("equidistant", (0.05, -0.01, 0.002, 0.01, 0.0, 0.0, 0.0, 0.0))])
def test_rectified_pixels_are_where_a_pinhole_sees_them(model, coefficients):
    lens = Intrinsics(640, 480, 500.0, 505.0, 320.0, 240.0, model, coefficients)
    points = np.array([[0.1, 0.05, 1.0], [-0.2, 0.1, 1.2], [0.0, -0.15, 0.9]])
    is_fisheye = model in ("equidistant", "fisheye", "kannala_brandt")
    project = cv2.fisheye.projectPoints if is_fisheye else cv2.projectPoints
    seen, _ = project(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), lens.K,
                      np.array(coefficients[:4 if is_fisheye else 14]))
    color = np.zeros((480, 640, 3), np.uint8)
    for (x, y), value in zip(seen.reshape(-1, 2), (90, 160, 250)):
        cv2.circle(color, (round(x), round(y)), 4, (value,) * 3, -1)
    view = geometry.rectify(View(0, lens, np.eye(4), color, labels=np.full((480, 640), 2,
                                                                           np.uint8)))
    assert not np.any(view.intrinsics.distortion)
    want, _ = geometry.project(points, view.intrinsics)
    for x, y in want:
        near = view.color[round(y) - 15:round(y) + 16, round(x) - 15:round(x) + 16, 0] > 40
        rows, cols = np.nonzero(near)
        assert [cols.mean() - 15, rows.mean() - 15] == pytest.approx([0, 0], abs=1.0)
    assert set(np.unique(view.labels)) <= {2, UNSEEN}


def test_crop_keeps_rays():
    depth = RANDOM.uniform(0.3, 1.0, (48, 64)).astype(np.float32)
    view = View(0, K, np.eye(4), depth=depth)
    part = geometry.crop(view, np.array([10.2, -5.0]), np.array([20.5, 15.0]))
    np.testing.assert_array_equal(part.depth, depth[0:16, 10:22])
    np.testing.assert_allclose(geometry.unproject(part.depth, part.intrinsics),
                               geometry.unproject(depth, K)[0:16, 10:22], atol=1e-6)
    with pytest.raises(ViewError, match="out_of_sight"):
        geometry.crop(view, np.array([100.0, 0]), np.array([120.0, 10]))


@pytest.mark.parametrize("changes", [{"fx": 0.0}, {"fy": -1.0}, {"cx": float("nan")},
                                     {"width": 0},
                                     {"distortion_model": "swirl", "distortion": (0.1,)},
                                     {"distortion_model": "equidistant",
                                      "distortion": (0.1, 0.0, 0.0, 0.0, 0.1)},
                                     {"distortion_model": "thin_prism",
                                      "distortion": (0.1,) * 15}])
def test_bad_calibrations_are_refused(changes):
    with pytest.raises(ViewError, match="expected") as caught:
        geometry.check_intrinsics(Intrinsics(**{**K.__dict__, **changes}))
    assert caught.value.reason == "bad_intrinsics"


@pytest.mark.parametrize("first, last", [
    ((1e300, 0), (1e301, 9)), ((np.nan, 0), (9, 9)), ((0, 0), (9, np.nan)), ((-1e300, 0), (-9, 9)),
    ((np.inf, 0), (np.inf, 9))])
def test_pixels_far_outside_leave_nothing(first, last):
    view = View(0, Intrinsics(20, 10, 9.0, 9.0, 9.0, 5.0), np.eye(4), np.zeros((10, 20, 3)))
    with pytest.raises(ViewError, match="expected some inside"):
        geometry.crop(view, np.array(first), np.array(last))
    whole = geometry.crop(view, np.array([-np.inf, -1e300]), np.array([1e300, np.inf]))
    assert whole.color.shape == (10, 20, 3) and whole.intrinsics == view.intrinsics
