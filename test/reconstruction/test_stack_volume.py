"""V and the container against closed forms."""

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.pipeline import StackCounter


def reconstruct(scene, noise=0.0, views=12, **settings):
    stack = StackCounter(ReconstructorConfig(**settings))
    for view in scene.views(views, noise=noise):
        stack.add_view(view)
    return stack.volume()


BOX = (0.2 * 0.15 * 0.06, lambda: Scene().box([0.02, 0.01, 0.03], [0.2, 0.15, 0.06], 0.3))
CYLINDER = (np.pi * 0.1**2 * 0.08, lambda: Scene().cylinder(0.02, 0.01, 0.1, 0.08))


@pytest.mark.parametrize("noise", [0.0, 0.001])
@pytest.mark.parametrize("solid", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_heap_within_3_percent_at_2_mm(solid, noise):
    truth, scene = solid
    result = reconstruct(scene(), noise)
    assert result.container.kind == "none"
    assert result.stack_volume == pytest.approx(truth, rel=0.03)


@pytest.mark.parametrize("solid", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_error_falls_with_the_voxel(solid):
    truth, scene = solid
    errors = [abs(reconstruct(scene(), voxel_size=s).stack_volume / truth - 1)
              for s in (0.008, 0.004, 0.002)]
    assert errors[0] > errors[1] > errors[2], errors


@pytest.mark.parametrize("wall, x, y, yaw", [(0.002, 0.03, -0.02, 0.4), (0.005, 0.0, 0.0, 0.0),
                                             (0.008, -0.05, 0.04, 1.0), (0.012, 0.1, 0.1, 2.2)])
def test_bin_is_found_and_filled_to_within_3_percent(wall, x, y, yaw):
    inner, fill = (0.3, 0.2, 0.12), 0.07
    scene = Scene().bin(inner, wall, wall, fill, x, y, yaw)
    result = reconstruct(scene, noise=0.001)
    box = result.container
    assert box.kind == "box"
    # Which of the two sides is called x is free.
    sides = sorted(box.inner_size_m[:2], reverse=True)
    assert sides == pytest.approx(inner[:2], rel=0.01)
    assert box.T_world_container[:2, 3] == pytest.approx([x, y], abs=0.002)
    found = np.arctan2(box.T_world_container[1, 0], box.T_world_container[0, 0])
    turn = (found - yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4
    assert abs(turn) < np.deg2rad(0.5)
    assert box.wall_thickness_m == pytest.approx(wall, abs=0.0015)
    assert result.stack_volume == pytest.approx(0.3 * 0.2 * fill, rel=0.03)
    assert abs(result.stack_volume / (0.3 * 0.2 * fill) - 1) \
        < 3 * result.stack_volume_std / result.stack_volume


def test_empty_bin_holds_nothing():
    result = reconstruct(Scene().bin((0.3, 0.2, 0.12), 0.005, 0.005, 0.0, yaw=0.4), noise=0.001)
    assert result.container.kind == "box"
    assert (result.stack_volume, result.stack_volume_std) == (0.0, 0.0)


def test_configured_container_is_used_as_given():
    scene = Scene().bin((0.3, 0.2, 0.12), 0.005, 0.009, 0.07, 0.03, -0.02, 0.4)
    given = reconstruct(scene, container_kind="box", container_pose="given",
                        container_inner_size_m=(0.3, 0.2, 0.12), container_wall_m=0.005,
                        container_floor_m=0.009, container_xyyaw=(0.03, -0.02, 0.4))
    assert given.container.inner_size_m == pytest.approx((0.3, 0.2, 0.12), abs=1e-6)
    assert given.stack_volume == pytest.approx(0.3 * 0.2 * 0.07, rel=0.02)
    found = reconstruct(scene, container_floor_m=0.009)  # the floor alone is told
    assert found.stack_volume == pytest.approx(0.3 * 0.2 * 0.07, rel=0.03)


def test_a_box_that_is_wanted_and_not_there_is_an_error():
    with pytest.raises(ScanError, match="no box container found"):
        reconstruct(BOX[1](), container_kind="box")


def test_bare_table_counts_nothing_and_says_so():
    result = reconstruct(Scene(), noise=0.0005)
    assert result.stack_volume == 0 and "nothing_found" in result.reasons
