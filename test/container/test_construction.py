# SPDX-License-Identifier: Apache-2.0
"""Containers of fitted walls and of settings: which size comes from where."""

import numpy as np
import pytest

from stack_counter.config import ReconstructorConfig
from stack_counter.container.construction import (
    has_given_size,
    has_plausible_floor,
    make_configured_container,
    make_fitted_container,
    no_container,
)
from stack_counter.container.wall_shapes import BoxWall, FreeWall, RoundWall
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region

REGION = Region(np.array([-0.2, -0.1, 0.18]), np.array([0.2, 0.3, 0.5]), 0.2, 0.001)
BOX = BoxWall(np.array([0.05, 0.1, 0.3, 0.2, 0.3, 0.0]))
ROUND = RoundWall(np.array([0.05, 0.1, 0.1, 0.0, 0.0]))
WALL, HEIGHT = 0.005, 0.12


def fitted(shape, base=0.0, **settings):
    return make_fitted_container(shape, WALL, HEIGHT, base, REGION,
                                 ReconstructorConfig(**settings))


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


def test_a_given_depth_begins_at_the_rim_as_it_is_not_as_it_is_worn():
    """The rim is seen 0.7 mm too low; 0.11 m below its true height lies the floor."""
    box = make_fitted_container(BOX, WALL, HEIGHT - 0.0007, 0.0, REGION, ReconstructorConfig(
        container_inner_size_m=(0.18, 0.28, 0.11)), worn=0.0007)
    assert box.floor_thickness_m == pytest.approx(0.01)
    assert box.inner_size_m[2] == pytest.approx(0.11)


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


def size_at(container, z):
    """(2,) inner size at a height above the support plane, m; rings are straight between."""
    rings = container.rings
    return np.array([np.interp(z, rings[:, 0, 2], np.ptp(rings[:, :, i], axis=1)) for i in (0, 1)])


def test_without_a_size_at_the_floor_the_measured_draft_stays():
    drafted = BOX.with_params(np.append(BOX.params[:5], 0.1))
    box = fitted(drafted, container_inner_size_m=(0.18, 0.28, 0.11), container_floor_m=0.01)
    assert size_at(box, 0.01) == pytest.approx(np.array([0.18, 0.28]) - 2 * 0.11 * 0.1)


@pytest.mark.parametrize("draft", [0.0, 0.3])
def test_size_at_the_floor_and_at_the_rim_give_each_pair_of_walls_its_draft(draft):
    """Whatever was fitted: 0.28 x 0.18 m at the rim, 0.26 x 0.12 m 0.11 m below it."""
    shape = BOX.with_params(np.append(BOX.params[:5], draft))
    box = fitted(shape, container_inner_size_m=(0.28, 0.18, 0.11),
                 container_floor_size_m=(0.26, 0.12))
    assert size_at(box, 0.01) == pytest.approx([0.26, 0.12])
    assert size_at(box, 0.065) == pytest.approx([0.27, 0.15])
    assert size_at(box, 0.12) == pytest.approx([0.28, 0.18])
    # Inside the outer face at the floor, 0.135 m from the middle, as far as the face is there.
    inside = box.wall_shape.depth_inside(np.array([[0.125, 0.0], [0.0, 0.055]]), np.full(2, 0.11))
    assert inside == pytest.approx([0.01, 0.01])


def test_a_size_at_the_floor_alone_belongs_to_the_measured_rim_longer_side_to_longer_side():
    box = fitted(BOX, container_floor_size_m=(0.25, 0.15))
    assert size_at(box, WALL) == pytest.approx([0.15, 0.25])
    assert box.inner_size_m[:2] == pytest.approx((0.19, 0.29))


@pytest.mark.parametrize("pose", ["found", "given"])
def test_a_bucket_becomes_a_cone(pose):
    settings = {"container_inner_size_m": (0.19, 0.19, 0.1), "container_kind": "round",
                "container_floor_size_m": (0.15, 0.15), "container_floor_m": 0.01}
    can = fitted(ROUND, **settings) if pose == "found" else make_configured_container(
        ReconstructorConfig(container_pose="given", container_wall_m=WALL, **settings), REGION)
    for z, size in ((0.01, 0.15), (0.06, 0.17), (0.11, 0.19)):
        assert size_at(can, z) == pytest.approx([size, size], rel=2e-3)


@pytest.mark.parametrize("shape, settings, said", [
    (BOX, {"container_floor_size_m": (0.2, 0.2)}, "no larger than at the rim"),
    (BOX, {"container_floor_size_m": (0.15, 0.0)}, "expected two sides above 0"),
    (FreeWall.from_outline(np.zeros(2), np.full(17, 0.1)),
     {"container_floor_size_m": (0.1, 0.1)}, "set container_kind, or teach the container by its")])
def test_a_floor_that_does_not_fit_the_rim_is_refused(shape, settings, said):
    with pytest.raises(ScanError, match=said):
        fitted(shape, **settings)


@pytest.mark.parametrize("size, want", [
    ((0.0, 0.0, 0.0), True), ((0.29, 0.19, HEIGHT - WALL), True), ((0.293, 0.187, 0.1), True),
    ((0.29, 0.25, 0.1), False), ((0.29, 0.19, HEIGHT + 0.01), False)])
def test_a_given_size_is_compared_with_what_was_found(size, want):
    config = ReconstructorConfig(container_inner_size_m=size)
    assert has_given_size(BOX, WALL, HEIGHT, config) == want


@pytest.mark.parametrize("settings, want", [
    ({}, True), ({"container_inner_size_m": (0.19, 0.29, HEIGHT - WALL)}, True),
    ({"container_inner_size_m": (0.19, 0.29, 0.08)}, False),
    ({"container_inner_size_m": (0.19, 0.29, 0.08), "container_floor_m": 0.04}, True)])
def test_a_depth_that_leaves_a_thick_floor_is_doubted(settings, want):
    config = ReconstructorConfig(**settings)
    assert has_plausible_floor(fitted(BOX, **settings), config) == want
