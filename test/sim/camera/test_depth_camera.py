# SPDX-License-Identifier: Apache-2.0
"""The noise of depth and poses."""

import numpy as np
import pytest

from stack_counter import geometry
from stack_counter.sim.camera.depth_camera import DepthCamera, perturb_pose
from stack_counter.types import Intrinsics


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
