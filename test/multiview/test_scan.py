# SPDX-License-Identifier: Apache-2.0
"""Pictures and labels without depth, through the whole of `StackCounter`."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene
from kits.textures import closed_container_views, textured_views

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.pipeline import StackCounter
from stack_counter.types import CONTAINER, PARTS

INNER, WALL, FLOOR, FILL = (0.16, 0.12, 0.07), 0.008, 0.008, 0.04
T_OTHER = geometry.pose_from_quaternion(np.array([0.2, -0.4, 0.5, np.sqrt(0.55)]),
                                        np.array([1.0, -2, 0.5]))


def volume(views, **settings):
    stack = StackCounter(ReconstructorConfig(**settings))
    for view in views:
        stack.add_view(view)
    return stack.volume()


def bin_label(points):
    inside = np.all(np.abs(points[..., :2]) < np.array(INNER[:2]) / 2 - 1e-4, axis=-1)
    return np.where(inside & (points[..., 2] < FLOOR + FILL + 1e-4), PARTS, CONTAINER)


@pytest.fixture(scope="module")
def bin_views():
    return textured_views(Scene().bin(INNER, WALL, FLOOR, FILL), bin_label)


@pytest.fixture(scope="module")
def found(bin_views):
    return volume(bin_views)


def test_an_open_bin_is_measured_as_with_a_depth_camera(found):
    assert found.container.kind == "box"
    assert found.container.inner_size_m[:2] == pytest.approx((0.16, 0.12), abs=0.006) \
        or found.container.inner_size_m[:2] == pytest.approx((0.12, 0.16), abs=0.006)
    assert found.stack_volume == pytest.approx(0.16 * 0.12 * FILL, rel=0.1)
    assert found.reasons == ("depth_from_pictures",)
    assert found.top is not None and found.coverage > 0.8
    assert found.key_view.depth is not None and (found.key_view.labels == PARTS).any()
    assert found.views.used == 12


def test_a_world_of_any_tilt_gives_the_same(found):
    views = textured_views(Scene().bin(INNER, WALL, FLOOR, FILL), bin_label, T_OTHER)
    turned = volume(views)
    assert turned.stack_volume == pytest.approx(found.stack_volume, rel=0.04)
    up = T_OTHER[:3, 2]
    for T in (turned.container.T_world_container, turned.top.T_world_map):
        assert T[:3, 2] == pytest.approx(up, abs=0.01)
    key = turned.key_view.stamp_ns
    assert turned.key_view.T_world_camera == pytest.approx(
        next(v for v in views if v.stamp_ns == key).T_world_camera, abs=0.003)
    high = geometry.apply(geometry.inverse(T_OTHER), turned.mesh.vertices.astype(float))[:, 2]
    assert np.percentile(high, 99.9) == pytest.approx(FLOOR + INNER[2], abs=0.005)


def test_a_heap_stands_on_the_support():
    heap = volume(textured_views(Scene().box([0, 0, 0.03], (0.14, 0.1, 0.06)),
                                 lambda points: np.full(points.shape[:-1], PARTS)))
    assert heap.container.kind == "none"
    assert heap.stack_volume == pytest.approx(0.14 * 0.1 * 0.06, rel=0.08)
    # A block with walls so smooth may as well be a full bin.
    assert heap.reasons == ("depth_from_pictures", "container_unsure")


def test_a_closed_container_is_what_labels_and_depth_leave():
    size = (0.14, 0.1, 0.06)
    bag = volume(closed_container_views(count=12))
    assert bag.container.kind == "hull"
    assert bag.stack_volume == pytest.approx(np.prod(size), rel=0.08)
    assert "depth_from_pictures" in bag.reasons
    assert np.nanmedian(bag.top.heights) == pytest.approx(0.06, abs=0.003)
    assert bag.inner.heights.shape == bag.top.heights.shape and not bag.inner.heights.any()


def test_where_stereo_sees_nothing_the_hull_stands(bin_views):
    blank = [replace(view, color=np.full_like(view.color, 100)) for view in bin_views]
    result, alone = volume(blank), volume([replace(view, color=None) for view in blank])
    assert alone.reasons == ("no_depth",)
    assert result.reasons == ("no_depth", "blurred_pictures")
    assert result.stack_volume == alone.stack_volume
    assert result.container.kind == "hull" and result.top is None


def test_counts_after_every_view_take_the_hull(bin_views):
    assert volume(bin_views[:6], live=True).reasons == ("no_depth",)


def test_labels_without_parts_are_an_empty_container(bin_views):
    empty = [replace(view, labels=np.minimum(view.labels, CONTAINER)) for view in bin_views]
    result = volume(empty)
    assert result.stack_volume == 0 and result.key_view is None
    assert result.reasons == ("nothing_found",)
