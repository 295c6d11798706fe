# SPDX-License-Identifier: Apache-2.0
"""`StackCounter`: refusals, tally, key view, rectification."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from kits.analytic import CAMERA, Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, ViewError
from stack_counter.pipeline import StackCounter
from stack_counter.types import PARTS, Intrinsics


def bin_scene():
    return Scene().bin((0.2, 0.15, 0.1), 0.005, 0.005, 0.05, yaw=0.3)


def test_too_few_views_say_how_many():
    stack = StackCounter(ReconstructorConfig())
    for view in bin_scene().views(2):
        stack.add_view(view)
    with pytest.raises(ScanError, match="2 views used of 2.*expected at least 3"):
        stack.volume()


def test_bad_views_are_counted_and_the_scan_goes_on():
    stack, views = StackCounter(ReconstructorConfig(max_views=6)), bin_scene().views(7)
    bad = [(replace(views[0], depth=np.zeros_like(views[0].depth)), "empty_depth"),
           (replace(views[0], depth=None), "no_depth"),
           (replace(views[0], intrinsics=replace(CAMERA, fx=0.0)), "bad_intrinsics"),
           (replace(views[0], intrinsics=replace(CAMERA, cy=float("nan"))), "bad_intrinsics")]
    for view in views[:6]:
        stack.add_view(view)
    bad.append((views[6], "too_many_views"))
    for view, _ in bad[-1:]:
        with pytest.raises(ViewError, match="too_many_views"):
            stack.add_view(view)
    fresh = StackCounter(ReconstructorConfig())
    for view, reason in bad[:-1]:
        with pytest.raises(ViewError) as caught:
            fresh.add_view(view)
        assert caught.value.reason == reason
    for view in views[:6]:
        fresh.add_view(view)
    assert fresh.tally.received == 10 and fresh.tally.used == 6
    assert fresh.tally.skipped == {"empty_depth": 1, "no_depth": 1, "bad_intrinsics": 2}
    assert fresh.volume().stack_volume == stack.volume().stack_volume


def test_too_few_views_say_why_the_others_were_refused():
    """Depth ten times too large, as where a unit is a tenth of what it is taken for."""
    stack = StackCounter(ReconstructorConfig())
    for view in bin_scene().views(2):
        with pytest.raises(ViewError):
            stack.add_view(replace(view, depth=view.depth * 10))
    with pytest.raises(ScanError, match="'empty_depth': 2.*half of it is beyond [5-9].*depth_scale"
                       ) as caught:
        stack.volume()
    assert "\n" not in str(caught.value)
    stack.start()
    with pytest.raises(ScanError, match="expected at least 3$"):
        stack.volume()


def test_depth_and_label_views_are_not_mixed():
    stack, views = StackCounter(ReconstructorConfig()), bin_scene().views(3)
    stack.add_view(views[0])
    labels = np.zeros(views[1].depth.shape, np.uint8)
    with pytest.raises(ViewError, match="no_depth"):
        stack.add_view(replace(views[1], depth=None, labels=labels))


def test_reset_forgets():
    stack = StackCounter(ReconstructorConfig())
    for view in Scene().box([0, 0, 0.05], [0.2, 0.2, 0.1]).views(6):
        stack.add_view(view)
    stack.start()
    assert stack.tally.received == 0
    for view in bin_scene().views(6):
        stack.add_view(view)
    again = StackCounter(ReconstructorConfig())
    for view in bin_scene().views(6):
        again.add_view(view)
    assert stack.volume().stack_volume == again.volume().stack_volume


def test_the_region_is_configured_then_found_and_holds_the_bin():
    configured = StackCounter(ReconstructorConfig(roi_center_m=(0.1, 0.0, 0.2),
                                                  roi_size_m=(0.4, 0.6, 0.8)))
    np.testing.assert_allclose(configured.region, [(-0.1, -0.3, -0.2), (0.3, 0.3, 0.6)])
    stack = StackCounter(ReconstructorConfig())
    assert stack.region is None and stack.views == []
    for view in bin_scene().views(4):
        stack.add_view(view)
    low, high = stack.region
    rim = 0.105 * np.array([-1, 1])  # half the longer side with its wall; the bin is turned
    assert (low[:2] < rim[0]).all() and (high[:2] > rim[1]).all()
    assert low[2] < 0 and 0.105 < high[2] < 0.2
    assert [v.stamp_ns for v in stack.views] == [0, 10**9, 2 * 10**9, 3 * 10**9]
    stack.start()
    assert stack.region is None


def test_key_view_shows_the_most_parts_and_is_cropped_to_them():
    stack, scene = StackCounter(ReconstructorConfig()), bin_scene()
    views = scene.views(6)
    near = scene.view(geometry.look_at(np.array([0, 0.02, 0.4]), np.array([0, 0, 0.05])),
                      stamp_ns=77)
    for view in [*views, near]:
        stack.add_view(view)
    key = stack.volume().key_view
    assert key.stamp_ns == 77
    parts = key.labels == PARTS
    assert key.part_pixels == np.count_nonzero(parts)
    assert parts[0].any() and parts[-1].any() and parts[:, 0].any() and parts[:, -1].any()
    # The crop's own calibration still says where its pixels are: all inside the bin.
    points = geometry.apply(key.T_world_camera, geometry.unproject(key.depth, key.intrinsics))
    assert np.abs(points[parts][:, 2] - 0.055).max() < 0.01
    assert np.linalg.norm(points[parts][:, :2], axis=1).max() < 0.13


def test_a_distorting_lens_gives_the_same_volume():
    lens = Intrinsics(640, 480, 610.0, 610.0, 319.5, 239.5, "plumb_bob",
                      (0.08, -0.1, 0.001, -0.001, 0.02))
    truth, scene = 0.2 * 0.15 * 0.05, bin_scene()
    rays = np.stack(np.meshgrid(np.arange(640.0), np.arange(480.0)), -1)[:, :, None]
    ideal = cv2.undistortPoints(rays.reshape(-1, 1, 2), lens.K, np.array(lens.distortion),
                                P=lens.K).reshape(480, 640, 2).astype(np.float32)
    stack, pinhole = (StackCounter(ReconstructorConfig()) for _ in range(2))
    for view in scene.views(12):
        pinhole.add_view(view)
        depth = cv2.remap(view.depth, ideal[..., 0], ideal[..., 1], cv2.INTER_NEAREST)
        stack.add_view(replace(view, depth=depth, intrinsics=lens))
    assert stack.volume().stack_volume == pytest.approx(pinhole.volume().stack_volume, rel=0.02)
    assert stack.volume().stack_volume == pytest.approx(truth, rel=0.05)


def test_an_unsure_scale_of_the_poses_widens_the_volume_by_three_times_as_much():
    def measured(scale_std):
        stack = StackCounter(ReconstructorConfig(scale_std=scale_std))
        for view in Scene().box([0, 0, 0.05], (0.1, 0.1, 0.1)).views(4):
            stack.add_view(replace(view, depth=None, labels=np.where(
                geometry.world_points(view)[..., 2] > 1e-4, PARTS, 0).astype(np.uint8)))
        return stack.volume()

    sure, unsure = measured(0.0), measured(0.02)
    assert unsure.stack_volume == sure.stack_volume
    assert unsure.stack_volume_std**2 - sure.stack_volume_std**2 == pytest.approx(
        (0.06 * sure.stack_volume)**2)


def test_live_counts_from_the_first_view():
    stack = StackCounter(ReconstructorConfig(live=True))
    stack.add_view(bin_scene().views(1, tilts=(5,))[0])
    assert stack.volume().stack_volume == pytest.approx(0.2 * 0.15 * 0.05, rel=0.15)


def watched(level):
    """A fixed camera above a bin that is filled flat up to `level`, metres."""
    scene = Scene().bin((0.2, 0.15, 0.1), 0.005, 0.005, level, yaw=0.3)
    return replace(scene.views(1, tilts=(8,))[0], fixed=True, camera="above")


@pytest.mark.parametrize("levels", [(0.06, 0.03), (0.03, 0.06)], ids=["taken out", "poured in"])
def test_live_is_not_one_view_behind(levels):
    """Ten views of one fill, one of another: the last one alone counts where they differ."""
    stack = StackCounter(ReconstructorConfig(live=True))
    for level in [levels[0]] * 10 + [levels[1]]:
        stack.add_view(watched(level))
        volume = stack.volume()
    assert volume.stack_volume == pytest.approx(0.2 * 0.15 * levels[1], rel=0.06)
    assert "one_side" in volume.reasons and volume.container.kind == "box"
    assert volume.views.used == 11


def test_live_goes_on_for_ever_and_forgets():
    stack = StackCounter(ReconstructorConfig(live=True, max_views=4))
    for i in range(9):
        stack.add_view(replace(watched(0.05), stamp_ns=i))
    stack.volume()
    assert stack.tally.used == 9 and len(stack.labelled_views()) == 2
