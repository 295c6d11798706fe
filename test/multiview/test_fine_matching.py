# SPDX-License-Identifier: Apache-2.0
"""Depth of large pictures, matched in a band around coarse depth, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from kits.textures import wavy_texture

from stack_counter import geometry
from stack_counter.multiview.fine_matching import SETTINGS, match_finely
from stack_counter.multiview.plane_sweep import Picture

K = np.array([[200.0, 0, 59.5], [0, 200.0, 44.5], [0, 0, 1]])
SHAPE = (90, 120)
PLANES = np.linspace(1 / 0.6, 1 / 0.4, 101)


def true_depth(x):
    """Depth, metres, of a surface (...) float at x of the reference: a slope, and a step of it."""
    return 0.5 + 0.3 * x - 0.03 * (x > 0.02)


def pictures(sides=(-0.08, 0.08, 0.05, -0.05)):
    """The reference, its true depth, and pictures from beside it: rays meet the surface."""
    rays = np.stack([*np.meshgrid((np.arange(SHAPE[1]) - K[0, 2]) / K[0, 0],
                                  (np.arange(SHAPE[0]) - K[1, 2]) / K[1, 1]), np.ones(SHAPE)],
                    axis=-1)
    out = []
    for side in (0.0, *sides):
        # March along the rays; none of them meets the surface before 0.3 m.
        depths = np.arange(0.3, 0.7, 0.0005)[:, None, None]
        below = depths >= true_depth(side + rays[..., 0] * depths)
        depth = depths[np.argmax(below, axis=0), 0, 0]
        points = rays * depth[..., None] + [side, 0, 0]
        out.append((Picture(wavy_texture(points, waves=60), K,
                            geometry.pose(np.eye(3), np.array([side, 0, 0]))), depth))
    return out[0][0], out[0][1], [picture for picture, _ in out[1:]]


@pytest.fixture(scope="module")
def scene():
    """Reference, true depth, neighbours, and the coarse depth: one value in 12 x 12 pixels."""
    reference, depth, neighbours = pictures()
    coarse = np.kron(depth[6::12, 6::12], np.ones((12, 12)))
    full = np.zeros(SHAPE)
    full[:coarse.shape[0], :coarse.shape[1]] = coarse[:SHAPE[0], :SHAPE[1]]
    return reference, depth, neighbours, full.astype(np.float32)


def depth_of(position):
    return np.where(position >= 0, 1 / np.interp(position, np.arange(len(PLANES)), PLANES), np.nan)


def test_a_slope_and_its_step_are_found_from_coarse_blocks(scene):
    reference, depth, neighbours, coarse = scene
    searched = np.ones(SHAPE, bool)
    found = depth_of(match_finely(reference, neighbours, coarse, searched, PLANES))
    inner = (slice(5, -5), slice(25, -25))  # all see it
    error = np.abs(found - depth)[inner]
    assert np.isfinite(error).mean() > 0.9
    assert np.nanmedian(error) < 0.0007
    assert np.nanpercentile(error, 90) < 0.004
    known = coarse > 0
    assert np.median(np.abs(coarse - depth)[known]) > 2.5 * np.nanmedian(error)


def test_only_what_is_searched_gets_depth(scene):
    reference, _, neighbours, coarse = scene
    searched = np.zeros(SHAPE, bool)
    searched[40:50, 50:60] = True
    position = match_finely(reference, neighbours, coarse, searched, PLANES)
    assert (position[~searched] == -1).all()
    assert (position[searched] >= 0).any()


def test_a_surface_outside_the_band_is_not_found(scene):
    reference, depth, neighbours, coarse = scene
    searched = np.ones(SHAPE, bool)
    near = np.where(coarse > 0, 0.42, 0).astype(np.float32)
    found = depth_of(match_finely(reference, neighbours, near, searched, PLANES,
                                  replace(SETTINGS, planes=8)))
    assert np.nanmean(np.abs(found - depth) < 0.003) < 0.05


def test_without_texture_nothing_is_known(scene):
    reference, _, neighbours, coarse = scene
    flat = [Picture(np.full(SHAPE, 90, np.float32), other.K, other.T_world_camera)
            for other in (reference, *neighbours)]
    position = match_finely(flat[0], flat[1:], coarse, np.ones(SHAPE, bool), PLANES)
    assert (position == -1).all()
