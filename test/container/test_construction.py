# SPDX-License-Identifier: Apache-2.0
"""Containers of fitted walls and of settings: which size comes from where."""

import numpy as np
import pytest

from stack_counter.config import ReconstructorConfig
from stack_counter.container.construction import (
    make_configured_container,
    make_fitted_container,
    no_container,
)
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region

REGION = Region(np.array([-0.2, -0.1, 0.18]), np.array([0.2, 0.3, 0.5]), 0.2, 0.001)
BOX = BoxWall(np.array([0.05, 0.1, 0.3, 0.2, 0.3, 0.0]))
ROUND = RoundWall(np.array([0.05, 0.1, 0.1, 0.0, 0.0]))
WALL, HEIGHT = 0.005, 0.12


def fitted(shape, **settings):
    return make_fitted_container(shape, WALL, HEIGHT, REGION, ReconstructorConfig(**settings))


def test_what_is_not_configured_is_as_fitted():
    box = fitted(BOX)
    assert box.inner_size_m == pytest.approx((0.19, 0.29, HEIGHT - WALL))
    assert (box.wall_thickness_m, box.floor_thickness_m) == (WALL, WALL)
    assert box.outer_size_m == pytest.approx((0.2, 0.3, HEIGHT))
    np.testing.assert_allclose(box.T_world_container[:3, 3], [0.05, 0.1, 0.2])
    assert fitted(BOX, container_floor_m=0.01).inner_size_m[2] == pytest.approx(0.11)


def test_a_configured_size_lies_along_the_longer_side():
    """The second fitted side is the longer one: x of the settings turns by a right angle."""
    box = fitted(BOX, container_inner_size_m=(0.28, 0.18, 0.11))
    assert box.inner_size_m == pytest.approx((0.28, 0.18, 0.11))
    np.testing.assert_allclose(box.T_world_container[:2, 0],
                               [np.cos(0.3 + np.pi / 2), np.sin(0.3 + np.pi / 2)], atol=1e-12)
    # Of the height, 0.12 m, the floor takes what the depth leaves.
    assert box.floor_thickness_m == pytest.approx(0.01)
    same = fitted(BOX, container_inner_size_m=(0.18, 0.28, 0.11))
    np.testing.assert_allclose(same.T_world_container[:2, 0], [np.cos(0.3), np.sin(0.3)])


def test_a_configured_diameter_is_that_of_the_opening():
    can = fitted(ROUND, container_inner_size_m=(0.18, 0.18, 0.0))
    assert can.inner_size_m == pytest.approx((0.18, 0.18, HEIGHT - WALL), rel=1e-3)


@pytest.mark.parametrize("kind", ["box", "round"])
def test_a_configured_pose_is_used_as_it_is(kind):
    box = make_configured_container(ReconstructorConfig(
        container_kind=kind, container_pose="given", container_xyyaw=(0.1, -0.1, 0.5),
        container_inner_size_m=(0.2, 0.2, 0.1), container_wall_m=0.004), REGION)
    assert box.kind == kind
    assert box.inner_size_m == pytest.approx((0.2, 0.2, 0.1), rel=1e-3)
    np.testing.assert_allclose(box.T_world_container[:3, 3], [0.1, -0.1, 0.2])
    assert box.floor_thickness_m == 0.004  # as the wall


@pytest.mark.parametrize("settings", [
    {"container_kind": "box", "container_inner_size_m": (0.2, 0.0, 0.1)},
    {"container_kind": "free", "container_inner_size_m": (0.2, 0.2, 0.1)}])
def test_a_pose_without_sizes_is_refused(settings):
    with pytest.raises(ScanError, match="needs three sizes above 0 and the kind box or round"):
        make_configured_container(ReconstructorConfig(container_pose="given", **settings), REGION)


def test_a_heap_stands_in_the_middle_of_the_region():
    heap = no_container(REGION)
    assert heap.kind == "none" and heap.rings is None and heap.outer_size_m == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(heap.T_world_container[:3, 3], [0.0, 0.1, 0.2])
