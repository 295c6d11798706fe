# SPDX-License-Identifier: Apache-2.0
"""An inner surface known from a CAD file: heights, outlines and labels in closed form."""

import numpy as np
import pytest

from stack_counter.container.construction import make_container, worn_rim_height
from stack_counter.container.inner_map import (
    grown_downwards,
    grown_upwards,
    sample_heights,
    trace_outlines,
    with_inner_map,
)
from stack_counter.container.inner_surface import map_rim_opening, outline_area
from stack_counter.container.wall_shapes import BoxWall
from stack_counter.fusion.region import Region
from stack_counter.segmentation.from_container import ContainerSegmenter
from stack_counter.types import CONTAINER, PARTS, InnerMap, Intrinsics, View

PITCH, FLOOR, LEDGE, RIM = 0.0005, 0.004, 0.05, 0.1
POSE = (0.03, -0.02, 0.4)


def stepped_map():
    """0.2 x 0.12 m at the rim, upright; below 0.05 m a ledge takes 0.02 m at the end of +x."""
    rows, cols = np.mgrid[:248, :408]
    x, y = (cols - 203.5) * PITCH, (rows - 123.5) * PITCH
    heights = np.where(x > 0.08, LEDGE, FLOOR)
    heights = np.where((np.abs(x) > 0.1) | (np.abs(y) > 0.06), RIM, heights)
    return InnerMap(PITCH, heights.astype(np.float32))


@pytest.fixture(scope="module")
def container():
    shape = BoxWall(np.array([*POSE, 0.208, 0.128, 0.0]))
    return with_inner_map(make_container(shape, 0.004, RIM, FLOOR, 0.0), stepped_map(), RIM)


def test_heights_are_those_of_the_cells():
    points = np.array([[0.0, 0.0], [0.0801, 0.0], [0.0799, 0.0], [0.1001, 0.0], [1.0, 0.0]])
    assert sample_heights(stepped_map(), points) == pytest.approx(
        [FLOOR, LEDGE, FLOOR, RIM, np.nan], nan_ok=True)


def test_outlines_step_at_the_ledge():
    rings = trace_outlines(stepped_map(), np.array([0.0, 0.04, 0.06, RIM]), FLOOR, RIM)
    areas = [outline_area(ring[:, :2]) for ring in rings]
    assert areas == pytest.approx([0.18 * 0.12, 0.18 * 0.12, 0.2 * 0.12, 0.2 * 0.12], rel=4e-3)
    assert rings[:, 0, 2] == pytest.approx([0.0, 0.04, 0.06, RIM])


def test_the_opening_holds_the_ledge_at_any_yaw(container):
    opening = map_rim_opening(container, 0.001)
    volume = float(np.nansum(RIM - opening.inner.heights)) * 1e-6
    assert volume == pytest.approx(0.2 * 0.12 * 0.096 - 0.02 * 0.12 * 0.046, rel=6e-3)
    assert opening.area == pytest.approx(0.2 * 0.12, rel=4e-3)
    assert container.inner_size_m == pytest.approx((0.2, 0.12, RIM - FLOOR), abs=6e-4)


def test_what_lies_on_a_ledge_is_parts_and_the_ledge_is_not(container):
    """Seen from straight above: the ledge itself, 20 mm above it, the floor, and above that."""
    region = Region(np.full(3, -0.5), np.full(3, 0.5), 0.0, 0.001)
    segmenter = ContainerSegmenter(container, region)
    c, s = np.cos(POSE[2]), np.sin(POSE[2])
    turn = np.array([[c, -s], [s, c]])
    for x, z, label in ((0.09, LEDGE, CONTAINER), (0.09, LEDGE + 0.02, PARTS),
                        (0.0, FLOOR, CONTAINER), (0.0, FLOOR + 0.02, PARTS)):
        T = np.diag([1.0, -1.0, -1.0, 1.0])
        T[:3, 3] = [*(turn @ [x, 0.0] + POSE[:2]), z + 0.5]
        view = View(0, Intrinsics(3, 3, 600.0, 600.0, 1.0, 1.0), T,
                    depth=np.full((3, 3), 0.5, np.float32))
        assert (segmenter.segment(view) == label).all(), (x, z)


def test_near_a_wall_all_is_wall():
    grown = grown_upwards(stepped_map(), 0.003)
    points = np.array([[0.0772, 0.0], [0.0765, 0.0], [0.0972, 0.0], [1.0, 0.0]])
    assert sample_heights(grown, points) == pytest.approx([LEDGE, FLOOR, RIM, np.nan], nan_ok=True)
    lowered = grown_downwards(stepped_map(), 0.003)
    points = np.array([[0.0828, 0.0], [0.0835, 0.0], [0.1015, 0.0], [1.0, 0.0]])
    assert sample_heights(lowered, points) == pytest.approx([FLOOR, LEDGE, LEDGE, np.nan],
                                                            nan_ok=True)


def test_a_rim_is_worn_less_the_thicker_it_is():
    worn = [worn_rim_height(thickness, 0.002) for thickness in (0.0, 0.003, 0.01)]
    assert worn == pytest.approx([0.0036, 0.00069, 0.0000147], rel=0.01)
