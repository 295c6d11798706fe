# SPDX-License-Identifier: Apache-2.0
"""How well the segmenters find the parts: intersection over union with rendered truth.

Every scene is recorded with colour, noisy depth and noisy poses and goes through `StackCounter`.
The prompts are what a user would mark in the first view: a loose box around the container, one
around the parts, and a few points on parts. A scene's IoU is of the pixels of all its views; one
that gives no volume has 0.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, ViewError
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.sets import find_set_folder
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, read_shard, record
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.types import CONTAINER, PARTS, View

# A user's boxes are too large by up to so many pixels on each side, and so many points on parts
# are clicked; chosen.
_LOOSE_PX, _POINTS = 8.0, 3


def run(args: argparse.Namespace) -> int:
    """Prints mean, 10th percentile and worst IoU of every segmenter; returns the exit code."""
    scenes = choose_scenes(find_set_folder(args.set), args.scenes, args.seed)
    score = partial(score_scene, views=args.views, seed=args.seed, depth=args.depth)
    rows = list(progress(map_tasks(score, scenes, Workers.of(args)), "labels", "scenes",
                         len(scenes)))
    for name in rows[0]["iou"]:
        print(f"{name}: {format_summary([row['iou'][name] for row in rows])}")
    if args.json:
        write_figures(args.json, rows)
    return 0


def format_summary(ious: list[float]) -> str:
    """One line on the IoU of many scenes."""
    return (f"IoU of parts mean {np.mean(ious):.3f}, p10 {np.quantile(ious, 0.1):.3f}, worst "
            f"{np.min(ious):.3f}, {len(ious)} scenes")


def choose_scenes(folder: Path, count: int, seed: int) -> list[Scene]:
    """Chooses scenes of a folder at random, about as many of each shard.

    Raises:
        FileNotFoundError: no shards.
    """
    paths = sorted(folder.glob("shard_*.npz"))
    if not paths:
        raise FileNotFoundError(f"no shard_*.npz in {folder}; expected those that simulate writes")
    random, scenes = np.random.default_rng(seed), []
    for number in random.permutation(len(paths))[:count]:
        shard = read_shard(paths[number])
        picked = random.permutation(len(shard))[:-(-count // len(paths))]
        scenes += [shard[i] for i in picked]
    return scenes[:count]


def score_scene(scene: Scene, views: int, seed: int, depth: bool) -> dict[str, Any]:
    """Scores one scene: its family, kind of container, and IoU by segmenter."""
    recorded = record(scene, views, seed, labels=True)
    return {"scene": scene.index, "family": scene.shape.family, "kind": scene.container.kind,
            "iou": score_views(recorded, np.random.default_rng([seed, scene.index]), depth)}


def score_views(views: list[View], random: np.random.Generator, depth: bool) -> dict[str, float]:
    """Scores views that hold the true labels: IoU by segmenter."""
    assert views[0].labels is not None  # for the type checker
    prompts = json.dumps(draw_user_prompts(views[0].labels, random))
    settings: dict[str, dict[str, Any]] = {}
    if depth:
        settings["geometric"] = {"segmenter": "geometric"}
    settings["prompted"] = {"segmenter": "prompted", "prompts": prompts}
    return {name: parts_iou(label_views(ReconstructorConfig(**setting), views, depth), views)
            for name, setting in settings.items()}


def draw_user_prompts(labels: np.ndarray, random: np.random.Generator) -> dict[str, Any]:
    """Draws what a user would mark in a view with these true labels, (h, w) uint8."""
    parts = labels == PARTS
    inner = ndimage.binary_erosion(parts, iterations=2)
    rows, cols = np.nonzero(inner if inner.any() else parts)
    clicked = random.integers(len(rows), size=_POINTS)
    marks: dict[str, Any] = {"parts": {
        "boxes": [_draw_box(parts, random)],
        "points": [[int(cols[i]), int(rows[i])] for i in clicked]}}
    if (labels == CONTAINER).any():
        marks["container"] = {"boxes": [_draw_box(parts | (labels == CONTAINER), random)]}
    return marks


def _draw_box(mask: np.ndarray, random: np.random.Generator) -> list[float]:
    """A loose box, x0, y0, x1, y1, around an (h, w) bool area."""
    rows, cols = np.nonzero(mask)
    tight = np.array([cols.min(), rows.min(), cols.max(), rows.max()])
    loose = tight + random.uniform(0, _LOOSE_PX, 4) * [-1, -1, 1, 1]
    return np.clip(loose, 0, [mask.shape[1], mask.shape[0]] * 2).round(1).tolist()


def label_views(config: ReconstructorConfig, views: list[View], depth: bool) -> list[View]:
    """Labels the views as a run with these settings does; none without a volume."""
    # Live scans look for no depth in pictures, which does not change the labels.
    counter = StackCounter(replace(config, live=not depth))
    for view in views:
        try:
            counter.add_view(replace(view, labels=None, depth=view.depth if depth else None))
        except ViewError:
            continue  # its pixels count as background
    try:
        counter.volume()
    except ScanError:
        return []
    return counter.labelled_views()


def parts_iou(labelled: list[View], truth: list[View]) -> float:
    """IoU of the parts' pixels of all true views; a labelled one may be cut, or missing."""
    whole = {view.stamp_ns: view for view in truth}
    shared = found = 0
    for view in labelled:
        full, k = whole[view.stamp_ns], view.intrinsics
        assert view.labels is not None and full.labels is not None  # for the type checker
        x, y = round(full.intrinsics.cx - k.cx), round(full.intrinsics.cy - k.cy)
        true = full.labels[y:y + k.height, x:x + k.width] == PARTS
        shared += int(np.count_nonzero(true & (view.labels == PARTS)))
        found += int(np.count_nonzero(view.labels == PARTS))
    there = sum(np.count_nonzero(view.labels == PARTS) for view in truth)
    return shared / (there + found - shared)
