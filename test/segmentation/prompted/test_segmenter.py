# SPDX-License-Identifier: Apache-2.0
"""Labels from prompts on scenes in closed form, through the segmenter and through the pipeline."""

import json
from dataclasses import replace

import numpy as np
import pytest
from kits.painted import SMALL, marks, painted, unlabelled

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ConfigError, ScanError, ViewError
from stack_counter.pipeline import StackCounter
from stack_counter.segmentation.prompted.segmenter import PromptedSegmenter, _shrink_view
from stack_counter.segmentation.prompts import parse_prompts
from stack_counter.types import CONTAINER, PARTS, Intrinsics, View


def iou(found, true):
    return np.count_nonzero(found & true) / np.count_nonzero(found | true)


def outline_bound(labels, value):
    """IoU of an area whose outline is off by half a pixel all around."""
    area = labels == value
    edge = np.count_nonzero(area[:, 1:] != area[:, :-1]) + np.count_nonzero(area[1:] != area[:-1])
    return 1 - edge / 2 / (np.count_nonzero(area) + edge / 4)


@pytest.mark.parametrize("depth", [True, False])
def test_prompts_of_the_first_view_label_all(depth):
    views = painted(depth=depth)
    found = PromptedSegmenter(ReconstructorConfig()).segment_views(
        unlabelled(views), parse_prompts(marks(views[0].labels)))
    for view, labels in zip(views, found):
        for value in (PARTS, CONTAINER):
            assert iou(labels == value, view.labels == value) \
                > outline_bound(view.labels, value), (view.stamp_ns, value)


def test_points_do_without_boxes():
    views = painted()
    middles = [np.argwhere(views[0].labels == value) for value in (PARTS, CONTAINER)]
    points = [[m[len(m) * i // 7][::-1].tolist() for i in (2, 3, 5)] for m in middles]
    prompts = parse_prompts({"parts": {"points": points[0]}, "container": {"points": points[1]},
                             "background": {"points": [[3, 3], [196, 146]]}})
    found = PromptedSegmenter(ReconstructorConfig()).segment_views(unlabelled(views), prompts)
    for view, labels in zip(views, found):
        assert iou(labels == PARTS, view.labels == PARTS) > outline_bound(view.labels, PARTS)


def test_a_large_view_is_made_smaller_with_its_calibration():
    """What a pixel shows lies on the same ray, and a depth is one that was measured."""
    k = Intrinsics(1920, 1080, 1400.0, 1410.0, 955.0, 545.0)
    depth = np.where(np.arange(1920) < 960, 0.5, 0.9).astype(np.float32) * np.ones((1080, 1))
    view = View(0, k, np.eye(4), np.zeros((1080, 1920, 3), np.uint8), depth.astype(np.float32),
                np.zeros((1080, 1920), np.uint8))
    small = _shrink_view(view)
    assert small.color.shape == (360, 640, 3) and small.labels is None
    assert (small.intrinsics.width, small.intrinsics.height) == (640, 360)
    assert set(np.unique(small.depth)) == {np.float32(0.5), np.float32(0.9)}
    points = np.array([[0.1, -0.2, 1.0], [-0.3, 0.1, 0.8]])
    (large, _), (shrunk, _) = (geometry.project(points, v.intrinsics) for v in (view, small))
    assert shrunk + 0.5 == pytest.approx((large + 0.5) / 3)
    assert _shrink_view(small) is small


def labelled_by_pipeline(views, prompts, **settings):
    stack = StackCounter(ReconstructorConfig(prompts=json.dumps(prompts), **settings))
    for view in views:
        stack.add_view(view)
    return stack.volume(), stack.labelled_views()


@pytest.mark.parametrize("bin_at", [(0.0, 0.0), (0.06, -0.04)])
def test_pixels_are_those_of_the_whole_first_view(bin_at):
    """The pipeline cuts views to the region of interest; prompts are marked before that."""
    views = painted(bin_at=bin_at)
    volume, labelled = labelled_by_pipeline(unlabelled(views), marks(views[0].labels))
    assert labelled[0].labels.shape != views[0].labels.shape
    for view, cut in zip(views, labelled):
        k = cut.intrinsics
        x, y = round(SMALL.cx - k.cx), round(SMALL.cy - k.cy)
        true = view.labels[y:y + k.height, x:x + k.width] == PARTS
        assert iou(cut.labels == PARTS, true) > outline_bound(view.labels, PARTS)
    assert volume.key_view.part_pixels == max(np.count_nonzero(v.labels == PARTS)
                                              for v in labelled)


def test_the_hull_of_prompted_labels_is_that_of_true_ones():
    views = painted(count=6, depth=False)
    true = StackCounter(ReconstructorConfig())
    for view in views:
        true.add_view(view)
    volume, _ = labelled_by_pipeline(unlabelled(views), marks(views[0].labels))
    # Half a pixel of 0.45 m / 190 on every side of the box.
    assert volume.stack_volume == pytest.approx(true.volume().stack_volume, rel=0.08)
    assert "no_depth" in volume.reasons


def test_live_from_the_first_view():
    views = painted(count=3)
    stack = StackCounter(ReconstructorConfig(live=True, prompts=json.dumps(
        marks(views[0].labels))))
    for i, view in enumerate(unlabelled(views)):
        stack.add_view(view)
        assert stack.volume().key_view.part_pixels > 500
        assert len(stack.labelled_views()) == i + 1


def test_views_that_cannot_be_labelled():
    views = unlabelled(painted(count=2))
    stack = StackCounter(ReconstructorConfig(prompts="{parts: {points: [[230, 5]]}}"))
    with pytest.raises(ViewError, match="bad_prompts: part_points .* outside of the 200x150"):
        stack.add_view(views[0])
    stack = StackCounter(ReconstructorConfig(prompts="{parts: {points: [[30, 5]]}}"))
    with pytest.raises(ViewError, match="no_color"):
        stack.add_view(replace(views[0], color=None))
    stack.add_view(views[0])
    stack.start()
    assert stack.tally.received == 0


def test_one_direction_of_sight_has_no_hull():
    view = painted(count=1, depth=False)[0]
    with pytest.raises(ScanError, match="along one direction"):
        PromptedSegmenter(ReconstructorConfig()).segment_views(
            [view, view], parse_prompts(marks(view.labels)))


@pytest.mark.parametrize("settings, said", [
    ({"segmenter": "prompted"}, "segmenter is 'prompted' and prompts is empty"),
    ({"segmenter": "geometric", "prompts": "{parts: {points: [[1, 2]]}}"}, "prompts is set and"),
    ({"prompts": "none.yaml"}, "no prompts file none.yaml")])
def test_settings_that_do_not_fit(settings, said):
    with pytest.raises(ConfigError, match=said):
        StackCounter(ReconstructorConfig(**settings))


def test_segmenters_that_need_their_input():
    view = painted(count=1)[0]
    with pytest.raises(ViewError, match="no_labels"):
        StackCounter(ReconstructorConfig(segmenter="labels")).add_view(unlabelled([view])[0])
    with pytest.raises(ViewError, match="no_depth"):
        StackCounter(ReconstructorConfig(segmenter="geometric")).add_view(
            replace(view, depth=None))


def test_given_labels_count_where_there_is_depth():
    views = painted(count=3)
    stack = StackCounter(ReconstructorConfig(segmenter="labels"))
    for view in views:
        stack.add_view(view)
    stack.volume()
    for view, cut in zip(views, stack.labelled_views()):
        assert np.count_nonzero(cut.labels == PARTS) == np.count_nonzero(view.labels == PARTS)
