# SPDX-License-Identifier: Apache-2.0
"""Heaps of trimesh's solids on the support plane against their volumes, and their footprints."""

import numpy as np
import pytest
import trimesh

from stack_counter.container.construction import no_container
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.fusion.volume_model import volume_model
from stack_counter.reconstruction.heap import SETTINGS, find_footprint
from stack_counter.reconstruction.stack_volume import measure_stack
from stack_counter.types import Mesh

PLANE = 0.3
REGION = Region(np.array([-0.15, -0.1, 0.28]), np.array([0.15, 0.1, 0.5]), PLANE, 0.001)


def surface_of(*solids):
    """Solids that stand on the support plane."""
    plane = trimesh.creation.box(bounds=[[-0.3, -0.3, PLANE - 0.01], [0.3, 0.3, PLANE]])
    meshes = [plane, *(s.apply_translation([0, 0, PLANE]) for s in solids)]
    mesh = trimesh.util.concatenate(meshes)
    return FusedSurface(Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32)))


def measure(surface, pitch=0.001, one_side=False, region=REGION):
    return measure_stack(surface, no_container(region), region, pitch, False, one_side)


@pytest.mark.parametrize("solid, share", [
    (trimesh.creation.cone(0.06, 0.05, sections=256), 1),
    (trimesh.creation.box(bounds=[[-0.05, -0.04, 0], [0.05, 0.04, 0.03]]), 1),
    (trimesh.creation.icosphere(5, 0.05), 0.5),
], ids=["cone", "box", "half ball"])
def test_v_is_the_solids_volume_and_the_worn_height_over_its_area(solid, share):
    volume = share * solid.volume  # what stands above the plane
    stack = measure(surface_of(solid.copy()))
    worn = volume_model().worn_height_m * stack.integral.area
    # What rises less than the threshold above the plane is not counted: of the cone 2 mm.
    assert stack.stack_volume - worn == pytest.approx(volume, rel=0.01)
    assert stack.coverage == 1 and stack.fill_level == (0, 0, 0)
    assert stack.boundary.is_heap and stack.boundary.rim_length == 0
    assert stack.stack_volume_std > volume_model().heap_std * stack.stack_volume


def test_the_error_of_a_cone_falls_with_the_pitch():
    cone = trimesh.creation.cone(0.06, 0.05, sections=256)
    volumes = []
    for pitch in (0.008, 0.001):
        stack = measure(surface_of(cone.copy()), pitch)
        volumes.append(stack.stack_volume - volume_model().worn_height_m * stack.integral.area)
    coarse, fine = (abs(v / cone.volume - 1) for v in volumes)
    assert fine < coarse


def heights_with_block(shape=(60, 80), rows=slice(20, 40), cols=slice(20, 50), height=0.03):
    """A map of the support plane with a block on it, and the block's cells."""
    block = np.zeros(shape, bool)
    block[rows, cols] = True
    return np.where(block, height, 0.0), block


def test_the_footprint_is_the_block_without_specks():
    heights, block = heights_with_block()
    heights[2, 2:2 + SETTINGS.min_cells - 1] = 0.03
    np.testing.assert_array_equal(find_footprint(heights, one_side=False), block)
    heights[2, 2:2 + SETTINGS.min_cells] = 0.03
    assert find_footprint(heights, one_side=False)[2, 2]


def test_an_unseen_hole_inside_belongs_to_the_heap():
    heights, block = heights_with_block()
    heights[28:32, 30:34] = np.nan
    np.testing.assert_array_equal(find_footprint(heights, one_side=False), block)


def test_an_unseen_gap_between_blocks_belongs_to_the_heap_only_from_one_side():
    heights, block = heights_with_block()
    gap = np.s_[20:40, 33:37]  # open at both ends
    for unseen in (True, False):
        heights[gap] = np.nan if unseen else 0.0
        around = find_footprint(heights, one_side=False)
        one_side = find_footprint(heights, one_side=True)
        assert not around[gap].any()
        assert one_side[25:35, 33:37].all() if unseen else not one_side[gap].any()
        np.testing.assert_array_equal(around | block, block)


def test_what_is_no_higher_than_the_planes_noise_is_no_heap():
    heights, block = heights_with_block(height=0.004)
    heights[~block] = np.random.default_rng(0).normal(0, 0.0015, np.count_nonzero(~block))
    assert not find_footprint(heights, one_side=False).any()
    heights[block] = 0.03
    np.testing.assert_array_equal(find_footprint(heights, one_side=False)[block], True)


def test_an_empty_plane_holds_nothing():
    stack = measure(surface_of())
    assert (stack.stack_volume, stack.stack_volume_std, stack.coverage) == (0.0, 0.0, 1.0)


def test_a_region_beside_everything_is_refused():
    away = Region(REGION.low + [2, 0, 0], REGION.high + [2, 0, 0], PLANE, 0.001)
    with pytest.raises(ScanError, match="0 cells of the footprint seen"):
        measure(surface_of(), region=away)
