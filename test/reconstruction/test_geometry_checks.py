# SPDX-License-Identifier: Apache-2.0
"""Stacks that contradict themselves, made cell by cell."""

from dataclasses import replace

import numpy as np
import pytest

from stack_counter.reconstruction.geometry_checks import check_geometry
from stack_counter.reconstruction.integral import FillIntegral, MeasuredStack, StackBoundary
from stack_counter.types import Container, HeightMap, Reason

PITCH, LENGTH, NOISE = 0.002, 0.02, 0.001


def stack_of(heights, kind="box", inner=0.0, filled_in=0.0):
    """A stack with these heights (rows, cols) above the support plane, all of them seen."""
    fill = (heights - inner)[np.isfinite(heights)]
    volume = float(np.maximum(fill, 0).sum()) * PITCH**2
    integral = FillIntegral(volume, filled_in * volume, fill.size * PITCH**2, fill)
    top, floor = (HeightMap(np.eye(4), PITCH, grid.astype(np.float32))
                  for grid in (heights, np.where(np.isfinite(heights), inner, np.nan)))
    return MeasuredStack(integral, 0.1 * volume, StackBoundary(kind == "none", 0.4, 0.01, 0.0),
                         top, floor, np.isfinite(heights), np.zeros(heights.shape, bool), 1.0,
                         (0.0, 0.0, 0.0), Container(kind, np.eye(4)))


def pile(height, slope):
    """Heights of a pile that falls off at its border with a slope; NaN around it."""
    rows, cols = np.mgrid[:80, :80]
    outside = np.max(np.abs([rows - 39.5, cols - 39.5]), axis=0) - 30
    heights = np.minimum(height, -outside * PITCH * slope)
    return np.where(heights > 0, heights, np.nan)


def test_a_stack_in_a_bin_contradicts_nothing():
    assert check_geometry(stack_of(np.full((50, 50), 0.04)), NOISE, LENGTH**3) == ()


def test_what_shows_below_the_wall_and_is_filled_in_is_a_contradiction():
    stack = stack_of(np.full((50, 50), 0.06))
    stack.below[10:40, 5:15] = True
    assert check_geometry(stack, NOISE, LENGTH**3) == (Reason.BELOW_FLOOR,)


@pytest.mark.parametrize("depth, is_wrong", [(0.02, True), (0.004, False)])
def test_a_surface_below_the_floor_is_a_contradiction(depth, is_wrong):
    heights = np.full((50, 50), 0.06)
    heights[10:30, 10:30] = 0.03 - depth
    found = check_geometry(stack_of(heights, inner=0.03), NOISE, LENGTH**3)
    assert (Reason.BELOW_FLOOR in found) == is_wrong


def test_noise_below_an_empty_floor_is_none():
    noisy = np.random.default_rng(0).normal(0.003, NOISE, (50, 50))
    assert check_geometry(stack_of(noisy, inner=0.003), NOISE, LENGTH**3) == ()


@pytest.mark.parametrize("height, side, is_wrong", [
    (0.0, 0, False), (0.03, 30, False), (0.4, 2, False), (0.2, 12, True), (0.4, 6, True)])
def test_what_towers_above_the_rim_is_no_loose_part(height, side, is_wrong):
    """A heap above the rim, a long part that sticks out of it, and an arm over the bin."""
    heights = np.full((50, 50), 0.07)
    heights[10:10 + side, 10:10 + side] += height
    stack = stack_of(heights, inner=0.01)
    stack = replace(stack, container=replace(stack.container, inner_size_m=(0.1, 0.1, 0.06)))
    assert (Reason.STEEP_HEAP in check_geometry(stack, NOISE, LENGTH**3)) == is_wrong


@pytest.mark.parametrize("share, is_wrong", [(0.15, False), (0.5, True)])
def test_a_stack_that_was_mostly_not_seen_says_so(share, is_wrong):
    stack = stack_of(np.full((50, 50), 0.04), filled_in=share)
    assert (Reason.MOSTLY_INFERRED in check_geometry(stack, NOISE, 0.0)) == is_wrong


@pytest.mark.parametrize("slope, is_wrong", [(0.6, False), (1.0, False), (100, True)])
def test_a_block_is_no_heap_and_a_pile_is_one(slope, is_wrong):
    stack = stack_of(pile(0.1, slope), "none")
    assert (Reason.STEEP_HEAP in check_geometry(stack, NOISE, LENGTH**3)) == is_wrong


def test_a_single_layer_of_parts_is_no_cliff():
    assert check_geometry(stack_of(pile(LENGTH, 100), "none"), NOISE, LENGTH**3) == ()


@pytest.mark.parametrize("noise, is_noisy", [(0.3, False), (0.4, True)])
def test_noise_of_depth_is_measured_in_parts(noise, is_noisy):
    stack = stack_of(np.full((50, 50), 0.04))
    found = check_geometry(stack, noise * LENGTH, LENGTH**3)
    assert found == ((Reason.NOISY_DEPTH,) if is_noisy else ())
    assert check_geometry(stack, noise * LENGTH, 0.0) == ()
