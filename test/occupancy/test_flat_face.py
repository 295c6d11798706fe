# SPDX-License-Identifier: Apache-2.0
"""A sheet on a pile is found, whichever way it leans; a pile and a bare floor are not sheets."""

import numpy as np
import pytest
from scipy import ndimage

from stack_counter.occupancy.flat_face import has_foreign_face, largest_flat_share
from stack_counter.occupancy.maps import StackMaps


def pile(side=120, height=3.0):
    """Maps of a surface as rough as parts: half a part length from crest to valley."""
    rough = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=(side, side)), 3)
    top = (height + 0.3 * rough / rough.std()).astype(np.float32)
    valid = np.ones((side, side), bool)
    return StackMaps(top, top.copy(), valid, np.full_like(top, 3))


def with_sheet(maps, share, slope=0.0, lift=1.0):
    """The maps with a sheet across a share of the columns, leaning along the rows."""
    rows, cols = np.indices(maps.top.shape)
    under = cols < share * maps.top.shape[1]
    top = np.where(under, maps.top.mean() + lift + slope * rows / 8, maps.top).astype(np.float32)
    return StackMaps(top, top, maps.valid, maps.wall)


def test_a_pile_has_no_large_flat_face():
    assert largest_flat_share(pile()) < 0.05
    assert not has_foreign_face(pile())


@pytest.mark.parametrize("slope", [0.0, 0.2, -0.15])
@pytest.mark.parametrize("share", [0.3, 0.8])
def test_the_share_of_a_sheet_is_found_whichever_way_it_leans(share, slope):
    assert largest_flat_share(with_sheet(pile(), share, slope)) == pytest.approx(share, abs=0.03)


def test_a_sheet_is_foreign_from_a_fifth_of_the_surface_on():
    assert not has_foreign_face(with_sheet(pile(), 0.15))
    assert has_foreign_face(with_sheet(pile(), 0.25))


def test_the_floor_beside_a_pile_is_no_sheet():
    maps = with_sheet(pile(), 0.6, lift=-3.0)
    assert largest_flat_share(maps) < 0.05


def test_a_wall_that_shows_is_no_sheet():
    assert largest_flat_share(with_sheet(pile(), 0.4, slope=3.0)) < 0.1


def test_a_large_map_is_thinned():
    assert largest_flat_share(with_sheet(pile(side=700), 0.4)) == pytest.approx(0.4, abs=0.03)


def test_an_empty_map_has_none():
    maps = pile()
    assert largest_flat_share(StackMaps(maps.top, maps.height, np.zeros_like(maps.valid),
                                        maps.wall)) == 0
