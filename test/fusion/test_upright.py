# SPDX-License-Identifier: Apache-2.0
"""Up is the normal of the plane that all stands on, on the side of the cameras."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene
from kits.recording_kit import SMALL, scan
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.fusion.upright import find_upright_pose, require_z_up
from stack_counter.pipeline import StackCounter

CAMERAS = np.array([geometry.look_at(np.array([0.5 * np.cos(a), 0.5 * np.sin(a), 0.4]),
                                     np.zeros(3)) for a in np.arange(6)])


def scene(random, ground=500):
    """A noisy ground at z = 0, a level top at 0.1 with more points than it, and walls."""
    top = random.uniform(-0.1, 0.1, (ground + 200, 3)) * [1, 1, 0] + [0, 0, 0.1]
    walls = random.uniform(-0.1, 0.1, (300, 3)) * [1, 0, 0.5] + [0, 0.1, 0.05]
    plane = random.uniform(-0.4, 0.4, (ground, 3)) * [1, 1, 0]
    return np.concatenate([plane, top, walls]) + random.normal(0, 0.0005, (2 * ground + 500, 3))


def test_the_lowest_plane_is_level_and_at_zero_however_the_world_is_turned():
    random = np.random.default_rng(0)
    points = scene(random)
    T = geometry.pose(Rotation.from_euler("xyz", [2.0, -0.7, 0.3]).as_matrix(), [3.0, -1, 2])
    found = find_upright_pose(geometry.apply(T, points), T @ CAMERAS)
    assert found.support_share == pytest.approx(500 / 1500, abs=0.03)
    upright = found.T_upright_world @ T
    assert upright[2, :3] == pytest.approx([0, 0, 1], abs=2e-3)
    assert geometry.apply(upright, points)[:500, 2] == pytest.approx(0, abs=3e-3)
    assert np.linalg.det(found.T_upright_world[:3, :3]) == pytest.approx(1)


def test_without_a_plane_up_is_that_of_the_pictures():
    points = np.random.default_rng(0).normal(size=(500, 3)) * 0.1
    found = find_upright_pose(points, CAMERAS)
    assert found.support_share == 0
    assert found.T_upright_world[2, :3] == pytest.approx([0, 0, 1], abs=0.1)


# --- worlds whose z is not up -----------------------------------------------------------------

def turned(views, axis, degrees):
    """The same views in a world that is turned."""
    T = geometry.pose(Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), np.zeros(3))
    return [replace(view, T_world_camera=T @ view.T_world_camera) for view in views]


@pytest.mark.parametrize("axis, degrees", [
    ("x", 3), ("y", 10), ("x", 25), ("x", -90), ("x", 180)])
def test_a_world_whose_z_is_not_up_is_refused(axis, degrees):
    line = f"tilted by {abs(degrees)} degrees in the world; expected z .* set world_frame to"
    with pytest.raises(ScanError, match=line):
        require_z_up(turned(scan(), axis, degrees))


def test_axes_of_opengl_are_refused():
    flipped = [replace(view, T_world_camera=view.T_world_camera @ np.diag([1.0, -1, -1, 1]))
               for view in scan()]
    with pytest.raises(ScanError, match="poses, which are of optical frames"):
        require_z_up(flipped)


def test_a_scan_that_is_refused_says_it_and_not_what_follows_from_it():
    counter = StackCounter(ReconstructorConfig(), 6e-6)
    for view in turned(scan(), "x", 180):
        counter.add_view(view)
    with pytest.raises(ScanError, match="tilted by 180 degrees"):
        counter.volume()
    # Who says where the support is needs no plane in sight.
    counter = StackCounter(ReconstructorConfig(support_height_m=0.0), 6e-6)
    for view in scan():
        counter.add_view(view)
    assert counter.volume().stack_volume > 0


@pytest.mark.parametrize("views", [
    turned(scan(), "x", 1.5), scan("empty"), scan("plane"), scan()[:1],
    [replace(view, depth=0 * view.depth) for view in scan()],
    Scene(plane=False).box((0, 0, -0.05), (0.05, 0.05, 0.1)).views(3, camera=SMALL)],
    ids=["nearly level", "an empty bin", "a plane", "one view", "nothing", "a small top"])
def test_other_views_are_not_refused(views):
    require_z_up(list(views))


def test_a_slope_of_parts_is_no_support_where_something_level_shows():
    slope = Scene().box((0, 0, 0.0), (0.6, 0.6, 0.02)).views(3, camera=SMALL)
    ramp = []  # a plane of 30 degrees that fills the views but for a strip of the floor
    for view in slope:
        depth = np.asarray(view.depth).copy()
        rays = geometry.pixel_rays(SMALL, dtype=np.float64) @ view.T_world_camera[:3, :3].T
        normal = np.array([-0.5, 0, np.sqrt(0.75)])
        distance = -(view.T_world_camera[:3, 3] @ normal) / (rays @ normal)
        depth[:, :110] = distance[:, :110]
        ramp.append(replace(view, depth=depth.astype(np.float32)))
    require_z_up(ramp)
