# SPDX-License-Identifier: Apache-2.0
"""Views with the poses of a real arm lie on each other after registration."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.registration import SETTINGS, pair_views, register_views
from stack_counter.fusion.view_shift import Agreement
from stack_counter.pipeline import StackCounter
from stack_counter.reconstruction import alignment

INNER, WALL, FILL = (0.3, 0.2, 0.12), 0.006, 0.03
REGION = Region(np.array([-0.2, -0.15, -0.04]), np.array([0.2, 0.15, 0.17]), 0.0, 0.001)


def true_views():
    """Views of a deep bin with a floor of boxes, which look alike to no other turn of it."""
    scene = Scene().bin(INNER, WALL, WALL, FILL)
    scene.box([-0.08, 0.03, 0.05], [0.05, 0.06, 0.04], 0.4).box([0.06, -0.04, 0.05],
                                                               [0.07, 0.04, 0.03], -0.7)
    return scene.views(noise=0.001)


def with_pose_noise(views, sigma_m, sigma_deg, seed=0):
    """The views with poses that are off in the camera's own frame."""
    random = np.random.default_rng(seed)
    errors = [geometry.pose(Rotation.from_rotvec(
        np.deg2rad(sigma_deg) * random.normal(size=3)).as_matrix(),
        random.normal(0, sigma_m, 3)) for _ in views]
    return [replace(view, T_world_camera=view.T_world_camera @ error)
            for view, error in zip(views, errors)]


def spread(views, true):
    """Distances (n,) m, of the scene's middle in each view from where the median puts it."""
    middle = np.array([0, 0, 0.05])
    places = np.array([geometry.apply(view.T_world_camera @ geometry.inverse(other.T_world_camera),
                                      middle) for view, other in zip(views, true)])
    return np.linalg.norm(places - np.median(places, axis=0), axis=1)


def test_every_pair_of_a_ring_is_there_once():
    assert pair_views(4, 1) == [(0, 1), (0, 3), (1, 2), (2, 3)]
    assert pair_views(2, 2) == [(0, 1)]
    assert len(pair_views(12, 2)) == 24


def test_poses_off_by_millimetres_are_brought_together():
    true = true_views()
    off = with_pose_noise(true, 0.003, 0.3)
    registered = register_views(off, REGION, (*SETTINGS.coarse, *SETTINGS.fine), 0.004)
    assert np.median(spread(off, true)) > 0.004
    assert np.median(spread(registered, true)) < 0.001


@pytest.mark.parametrize("sigma_m", [0.003, 0.0003])
def test_v_is_right_with_the_poses_of_a_bad_arm_and_a_good_one(sigma_m):
    volume = measure(with_pose_noise(true_views(), sigma_m, 100 * sigma_m))
    boxes = 0.05 * 0.06 * 0.034 + 0.07 * 0.04 * 0.029
    assert volume.container.kind == "box"
    assert volume.stack_volume == pytest.approx(INNER[0] * INNER[1] * FILL + boxes, rel=0.04)
    assert 0 < volume.view_agreement_m < 0.001
    assert 0.001 <= volume.resolution_m <= 0.002


def test_views_that_agree_are_not_registered(monkeypatch):
    monkeypatch.setattr(alignment, "register_views", None)
    measure(with_pose_noise(true_views(), 0.0003, 0.03))


def test_views_that_cannot_be_brought_together_are_refused(monkeypatch):
    monkeypatch.setattr(alignment, "register_views", lambda views, region, levels, apart: views)
    monkeypatch.setattr(alignment, "measure_agreement", lambda views, region: Agreement(0.0063))
    with pytest.raises(ScanError, match=r"disagree by 6\.3 mm.*expected below 5\.0 mm: calibrate"):
        measure(true_views())


def measure(views):
    counter = StackCounter(ReconstructorConfig())
    for view in views:
        counter.add_view(view)
    return counter.volume()
