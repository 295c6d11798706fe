# SPDX-License-Identifier: Apache-2.0
"""What the network reads: lengths in parts, tiles, and maps of a single view."""

import numpy as np
import pytest
from kits.surfaces import sine_hills, stack_volume_of_heights

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.occupancy.maps import (
    CHANNELS,
    PIXELS_PER_LENGTH,
    TILE,
    make_maps,
    network_channels,
    split_into_tiles,
    stack_maps,
    stack_maps_of_key_view,
    surface_features,
)
from stack_counter.types import (
    PARTS,
    Intrinsics,
    KeyView,
)


def test_a_stack_ten_times_as_large_of_parts_ten_times_as_large_looks_the_same():
    small = stack_maps(stack_volume_of_heights(sine_hills(1.0), 0.01, 0.002), 0.012**3)
    large = stack_maps(stack_volume_of_heights(sine_hills(10.0), 0.1, 0.02), 0.12**3)
    np.testing.assert_allclose(network_channels(small), network_channels(large), atol=1e-4)


def test_heights_and_sides_are_in_parts():
    maps = stack_maps(stack_volume_of_heights(np.full((60, 90), 0.05), 0.01, 0.002), 0.02**3)
    assert maps.height == pytest.approx(2.0)
    assert maps.top == pytest.approx(2.5)
    assert maps.valid.shape == (6 * PIXELS_PER_LENGTH, 9 * PIXELS_PER_LENGTH)
    assert maps.wall.max() == 3.0  # the middle is 3 l from the nearest wall
    assert maps.wall[0].max() < 0.2


def test_a_heap_has_no_wall():
    maps = stack_maps(stack_volume_of_heights(np.full((60, 90), 0.05), kind="none"), 0.02**3)
    assert (maps.wall == 3.0).all()


def test_what_is_not_valid_does_not_leak_into_the_heights():
    heights = np.full((60, 60), 0.05)
    heights[:, :20] = np.nan
    maps = stack_maps(stack_volume_of_heights(heights), 0.013**3)
    assert maps.top[maps.valid] == pytest.approx(0.05 / 0.013)
    assert not maps.top[~maps.valid].any()


@pytest.mark.parametrize("rows, cols, count", [(40, 40, 1), (112, 112, 1), (130, 90, 2),
                                               (300, 90, 4), (300, 300, 16)])
def test_tiles_cover_the_stack(rows, cols, count):
    surface = np.random.default_rng(0).uniform(1, 2, (rows, cols)).astype(np.float32)
    maps = make_maps(surface, np.zeros_like(surface), np.ones((rows, cols), bool), True)
    pieces = split_into_tiles(maps)
    assert len(pieces) == count
    assert all(piece.top.shape == (TILE, TILE) for piece in pieces)
    seen = {round(float(v), 6) for piece in pieces for v in piece.top[piece.valid]}
    assert len(seen) >= 0.75 * rows * cols
    assert network_channels(pieces[0]).shape == (CHANNELS, TILE, TILE)


@pytest.mark.parametrize("heights, unit_volume, message", [
    (None, 1e-6, "no top-surface map"),
    (np.full((5, 5), np.nan), 1e-6, "0 of 25 cells"),
    (np.full((500, 500), 0.1), 1e-12, "part lengths wide"),
    (np.full((1, 50), 0.1), 0.02**3, "0.1 part lengths wide; expected at least"),
    (np.full((40, 40), 90.0), 1e-6, "part lengths high; expected at most 2560"),
])
def test_what_cannot_be_read_is_refused(heights, unit_volume, message):
    with pytest.raises(ScanError, match=message):
        stack_maps(stack_volume_of_heights(heights), unit_volume)


def test_features_tell_a_wrong_part_size():
    right = surface_features(stack_maps(stack_volume_of_heights(sine_hills(1.0)), 0.012**3))
    wrong = surface_features(stack_maps(stack_volume_of_heights(sine_hills(1.0)), 0.036**3))
    assert right.shape == (6,) and np.isfinite(wrong).all()
    assert right[0] - wrong[0] == pytest.approx(np.log(3), abs=0.05)  # mean height in l


def test_a_key_view_alone_gives_the_surface_along_its_axis():
    k = Intrinsics(80, 60, 100.0, 100.0, 39.5, 29.5)
    depth = np.full((60, 80), 0.5, np.float32)
    depth[20:40, 30:50] = 0.45
    labels = np.full((60, 80), PARTS, np.uint8)
    view = KeyView(0, k, geometry.pose(np.eye(3), np.zeros(3)), 4800, labels, depth)
    volume = stack_volume_of_heights(None, kind="hull", key_view=view)
    maps = stack_maps_of_key_view(volume, 0.025**3)
    assert np.percentile(maps.height[maps.valid], 99) == pytest.approx(2.0, abs=0.05)
    assert np.median(maps.height[maps.valid]) == pytest.approx(0.0, abs=0.05)
    # 0.4 m by 0.3 m in view
    assert maps.valid.shape == pytest.approx((0.3 / 0.025 * 8, 0.4 / 0.025 * 8), abs=3)


def test_a_key_view_without_depth_is_refused():
    with pytest.raises(ScanError, match="no depth in the key view"):
        stack_maps_of_key_view(stack_volume_of_heights(None), 1e-6)
