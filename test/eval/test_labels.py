# SPDX-License-Identifier: Apache-2.0
"""Label metrics: exact answers, and prompts as a user gives them."""

import argparse
from dataclasses import replace

import numpy as np
import pytest
from kits.painted import painted

from stack_counter import geometry
from stack_counter.eval.arguments import ADD_ARGUMENTS
from stack_counter.eval.labels import (
    choose_scenes,
    draw_user_prompts,
    format_summary,
    parts_iou,
    score_views,
)
from stack_counter.segmentation.prompts import parse_prompts
from stack_counter.types import CONTAINER, PARTS


def test_iou_is_exact_for_whole_cut_and_missing_views():
    views = painted()
    there = [np.count_nonzero(view.labels == PARTS) for view in views]
    assert parts_iou(views, views) == 1
    cut = [geometry.crop(view, np.array([7, 5]), np.array([180, 140])) for view in views]
    assert parts_iou(cut, views) == 1
    assert parts_iou(views[1:], views) == sum(there[1:]) / sum(there)
    wrong = views[0].labels.copy()
    wrong[0, 0] = PARTS
    assert parts_iou([replace(views[0], labels=wrong), *views[1:]], views) \
        == sum(there) / (sum(there) + 1)
    assert parts_iou([], views) == 0


@pytest.mark.parametrize("seed", range(5))
def test_prompts_are_loose_boxes_and_points_on_parts(seed):
    labels = painted()[0].labels
    marks = parse_prompts(draw_user_prompts(labels, np.random.default_rng(seed)))
    marks.check(labels.shape[1], labels.shape[0])
    for x, y in marks.part_points.astype(int):
        assert labels[y, x] == PARTS
    for box, area in ((marks.part_boxes[0], labels == PARTS),
                      (marks.container_boxes[0], labels != 0)):
        rows, cols = np.nonzero(area)
        assert box[0] <= cols.min() and box[1] <= rows.min()
        assert box[2] >= cols.max() and box[3] >= rows.max()
    heap = np.where(labels == CONTAINER, 0, labels)
    assert "container" not in draw_user_prompts(heap, np.random.default_rng(seed))


def test_both_segmenters_are_scored_as_the_product_runs_them():
    views = painted(count=4)
    scores = score_views(views, np.random.default_rng(0), depth=True)
    assert scores.keys() == {"geometric", "prompted"} and min(scores.values()) > 0.8
    colored = painted(count=4, depth=False)
    assert score_views(colored, np.random.default_rng(0), depth=False).keys() == {"prompted"}


def test_summary_and_arguments(tmp_path):
    assert (
        format_summary([0.5, 1.0, 0.9])
        == "IoU of parts mean 0.800, p10 0.580, worst 0.500, 3 scenes"
    )
    parser = argparse.ArgumentParser()
    ADD_ARGUMENTS["labels"](parser)
    args = parser.parse_args(["--set", str(tmp_path), "--no-depth"])
    assert args.depth is False and args.json is None
    with pytest.raises(FileNotFoundError, match="no shard_"):
        choose_scenes(tmp_path, 3, 0)
