# SPDX-License-Identifier: Apache-2.0
"""Views that contradict each other are named, left out or refused, in any order."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.registration import pair_views
from stack_counter.pipeline import StackCounter
from stack_counter.reconstruction.view_agreement import (
    check_agreement,
    contradicting_views,
    split_pairs,
    views_to_leave_out_first,
)
from stack_counter.reconstruction.view_pairs import ViewPair, compare_views
from stack_counter.types import Reason

INNER, FILL = (0.3, 0.2, 0.12), 0.07
TRUE_VOLUME = 0.3 * 0.2 * FILL
REGION = Region(np.array([-0.2, -0.2, -0.04]), np.array([0.2, 0.2, 0.16]), 0.0, 0.001)


def bin_views(count=12, **how):
    return [replace(view, camera="camera_optical_frame") for view in
            Scene().bin(INNER, 0.005, 0.005, FILL).views(count, noise=0.001, **how)]


def shorten(views, index, by=0.08):
    """The views, of which one measures depth too short."""
    short = replace(views[index], depth=np.maximum(views[index].depth - np.float32(by), 0))
    return [*views[:index], short, *views[index + 1:]]


def measure(views, **settings):
    counter = StackCounter(ReconstructorConfig(**settings))
    for view in views:
        counter.add_view(view)
    return counter.volume()


def test_good_views_agree_to_their_noise():
    pairs = compare_views(bin_views(), REGION)
    assert len(pairs) == 24
    assert max(pair.apart_m for pair in pairs) < 0.002
    assert contradicting_views(pairs, 12) == []


@pytest.mark.parametrize("wrong", ["shifted", "inverted"])
def test_views_with_the_poses_of_others_are_refused(wrong):
    views = bin_views()
    poses = [v.T_world_camera for v in views]
    bad = poses[1:] + poses[:1] if wrong == "shifted" else [geometry.inverse(T) for T in poses]
    views = [replace(v, T_world_camera=T) for v, T in zip(views, bad)]
    with pytest.raises(ScanError, match=r"the views disagree by \d+ mm"):
        check_agreement(views, compare_views(views, REGION), 3)


@pytest.mark.parametrize("index", [0, 1])
def test_one_of_two_views_that_is_short_is_refused_in_either_order(index):
    """Nothing says which of the two is right: both are named."""
    with pytest.raises(ScanError, match=r"disagree by \d+ mm.* \(off: view 1 of camera_optical_"
                                        r"frame at 0\.000 s, view 2 of .* at 1\.000 s\)"):
        measure(shorten(bin_views(2), index), min_views=1)


@pytest.mark.parametrize("index", [0, 1, 7])
def test_one_short_view_of_twelve_is_left_out_and_counted(index):
    volume = measure(shorten(bin_views(), index))
    assert volume.views.skipped == {"contradicts_others": 1} and volume.views.used == 11
    assert volume.stack_volume == pytest.approx(TRUE_VOLUME, rel=0.03)


def test_of_three_views_the_one_that_is_off_is_named_where_two_are_too_few():
    with pytest.raises(ScanError, match=r"\(off: view 2 of [^,]*\)"):
        measure(shorten(bin_views(3), 1), min_views=3)


def test_what_contradicts_only_the_wrong_view_is_not_to_blame():
    shares = {(0, 1): 1.0, (0, 2): 0.0, (1, 2): 1.0}
    pairs = [ViewPair(*views, share, share, share, 0.0) for views, share in shares.items()]
    assert contradicting_views(pairs, 3) == [1]


def test_what_stands_says_which_view_is_wrong_only_where_the_others_agree():
    """Of poses off by millimetres the sides of what stands contradict each other in all views."""
    def pairs_of(others):
        return [ViewPair(i, j, 0.4 if 3 in (i, j) else others, 0.05, 0.0, 0.0)
                for i, j in pair_views(8, 2)]

    assert views_to_leave_out_first(pairs_of(0.02), 8, 3) == [3]
    assert views_to_leave_out_first(pairs_of(0.2), 8, 3) == []
    wrong = [replace(pair, contradicted_in_all=pair.contradicted) for pair in pairs_of(0.2)]
    assert views_to_leave_out_first(wrong, 8, 3) == [3]


def test_two_views_that_contradict_are_both_off():
    assert sorted(contradicting_views([ViewPair(0, 1, 0.9, 0.9, 0.9, 0.1)], 2)) == [0, 1]


# --- what stands is moved, and the plane around it looks as before -----------------------------

def moved(views, which, by):
    """The views, some of which see everything moved by so many metres along the support."""
    shift = geometry.pose(np.eye(3), np.array([by, 0.4 * by, 0]))
    return [replace(view, T_world_camera=shift @ view.T_world_camera) if i in which else view
            for i, view in enumerate(views)]


@pytest.mark.parametrize("by", [0.03, 0.06])
def test_one_view_in_which_all_is_moved_is_left_out(by):
    volume = measure(moved(bin_views(), [7], by))
    assert volume.views.skipped == {"contradicts_others": 1}
    assert volume.stack_volume == pytest.approx(TRUE_VOLUME, rel=0.03)


@pytest.mark.parametrize("by, count", [(0.012, 12), (0.012, 24), (0.06, 12)])
def test_a_bin_that_is_moved_halfway_is_told_or_refused(by, count):
    views = moved(bin_views(count), range(count // 2, count), by)
    if by < 0.02:
        assert Reason.VIEWS_APART in measure(views).reasons
        return
    with pytest.raises(ScanError, match=r"pairs of views disagree, view \d+ of .* and view .*; "
                                        r"expected below 25%: let nothing move or come"):
        measure(views)


def test_what_rides_with_the_camera_contradicts_nothing():
    views = bin_views(24)
    for view in views:
        rows, cols = view.depth.shape
        for left in (cols // 5, 3 * cols // 5):  # two fingers of a gripper
            view.depth[-rows // 3:, left:left + cols // 8] = 0.3
    volume = measure(views)
    assert volume.views.skipped == {}
    assert volume.stack_volume == pytest.approx(TRUE_VOLUME, rel=0.03)


def test_what_comes_into_sight_in_two_views_moves_no_pose():
    views = bin_views()
    hand = Scene().bin(INNER, 0.005, 0.005, FILL).box([0.02, 0, 0.2], (0.12, 0.1, 0.06)).views(
        12, noise=0.001)
    volume = measure([replace(view, depth=hand[i].depth) if i in (1, 2) else view
                      for i, view in enumerate(views)])
    assert volume.view_agreement_m < 0.0004
    assert volume.stack_volume == pytest.approx(TRUE_VOLUME, rel=0.03)


def test_one_pair_alone_splits_nothing():
    pairs = [ViewPair(i, i + 1, share, share, share, 0.0)
             for i, share in enumerate((0.0, 0.9, 0.0))]
    assert split_pairs(pairs) == []
    worst = ViewPair(4, 5, 1.0, 1.0, 1.0, 0.0)
    assert split_pairs([*pairs, worst])[0] is worst
    assert split_pairs([*pairs, worst], [5]) == []
    taken = [replace(pair, appeared=0.0) for pair in [*pairs, worst]]
    assert split_pairs(taken) == []  # taken away, and not there from then on
