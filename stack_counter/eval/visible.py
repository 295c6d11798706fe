# SPDX-License-Identifier: Apache-2.0
"""How well the parts that show are located one by one.

stack-counter evaluate visible --set unseen

A part is found where one is told within half a part length of the middle of what shows of it, seen
from above. Recall is of the parts that show more than half, precision of all that are told. With
`--poses N` the mesh is known, and the poses of the best N parts of each scene are measured too.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.display.drawings import draw_heights
from stack_counter.errors import ScanError, ViewError
from stack_counter.eval.common.cases import measure_volume
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.pose_errors import (
    PoseError,
    draw_silhouette,
    format_poses,
    is_right,
    measure_poses,
)
from stack_counter.eval.common.sets import read_filled_scenes
from stack_counter.sim import Scene, match_parts, parts_from_above, surface_grid
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.types import HeightMap, Mesh, VisiblePart
from stack_counter.visible_parts.finder import VisiblePartFinder, make_finder

# Distance within which a part is found, part lengths; share from which a part shows at all, and
# from which it should be found. The first and the last are what the figures are defined by.
_REACH, _SHOWS, _MOSTLY = 0.5, 0.1, 0.5
_GREEN, _RED, _YELLOW = (90, 200, 60), (60, 60, 230), (40, 220, 240)  # BGR


@dataclass(frozen=True)
class VisibleCase:
    """One scene.

    Attributes:
        index: number of the scene in its set.
        family, kind: of the part, and of the simulated container.
        count: parts in the scene.
        shown: of these, parts that show at all.
        told, right: parts that were told, and how many of them are there.
        mostly_shown, found: parts that show more than half, and how many of them were told.
        share_error: mean error of the share that shows, of the right ones; NaN if there are none.
        seconds: time that finding took; NaN if the scan was refused.
        refused: why the scan was refused; empty if it was not.
        poses: how far the told poses are off.
    """

    index: int
    family: str
    kind: str
    count: int
    shown: int
    told: int = 0
    right: int = 0
    mostly_shown: int = 0
    found: int = 0
    share_error: float = np.nan
    seconds: float = np.nan
    refused: str = ""
    poses: tuple[PoseError, ...] = ()


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    _load_finder(options.weights, options.poses)  # raises here, not in a worker
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    jobs = [(scene, options) for scene in read_filled_scenes(options.set, options.scenes)]
    cases = list(progress(map_tasks(_measure_job, jobs, Workers.of(options)), "visible parts",
                          "scenes", len(jobs)))
    print(f"{options.set}: visible parts of {len(cases)} scenes, {options.depth} depth")
    print(format_table(cases))
    if errors := [error for case in cases for error in case.poses]:
        print(format_poses(errors))
    if options.json:
        write_figures(options.json, cases)
    return 0


@cache
def _load_finder(weights: Path | None, poses: int) -> VisiblePartFinder:
    """Loads the network once for each process.

    Raises:
        WeightsError: it cannot be loaded.
    """
    return make_finder(str(weights or ""), poses)


def _measure_job(job: tuple[Scene, argparse.Namespace]) -> VisibleCase:
    """Records and measures a scene as the options say."""
    scene, options = job
    finder = _load_finder(options.weights, options.poses)
    return measure_scene(scene, finder, options.depth, options.views, options.pictures)


def measure_scene(scene: Scene, finder: VisiblePartFinder, depth: str, views: int,
                  pictures: Path | None = None) -> VisibleCase:
    """Measures one scene: `depth` and `views` as of the command; draws it into a folder."""
    # The truth.
    true = parts_from_above(scene)
    places = surface_grid(scene).world_xy(scene.container.T_world_container, true.centers)
    shares, places = true.shares[true.shares >= _SHOWS], places[true.shares >= _SHOWS]
    facts = (scene.index, scene.shape.family, scene.container.kind, scene.truth.count, len(shares))
    # What is found.
    try:
        volume = measure_volume(scene, depth, views)
    except (ScanError, ViewError) as refused:
        return VisibleCase(*facts, refused=str(refused))
    mesh = Mesh(scene.shape.vertices.astype(np.float32), scene.shape.faces)
    begin = time.perf_counter()
    parts = finder.find(volume, scene.truth.unit_volume, mesh)
    seconds = time.perf_counter() - begin
    if parts is None:
        return VisibleCase(*facts, refused="the surface cannot be read")
    # Compare.
    found = np.array([part.position[:2] for part in parts]).reshape(-1, 2)
    match = match_parts(found, places, _REACH * scene.truth.unit_volume ** (1 / 3))
    right = match >= 0
    told_shares = np.array([part.share_visible for part in parts])
    errors = np.abs(told_shares[right] - shares[match[right]])
    poses = measure_poses([part.pose for part in parts], scene.part_poses(), mesh)
    if pictures is not None and volume.top is not None:
        picture = draw_found(volume.top, parts, right)
        draw_poses(picture, volume.top, parts, poses, mesh)
        cv2.imwrite(str(pictures / f"scene_{scene.index:05d}.png"), picture)
    return VisibleCase(
        *facts, told=len(parts), right=int(right.sum()),
        mostly_shown=int((shares > _MOSTLY).sum()), seconds=seconds,
        found=int((shares[match[right]] > _MOSTLY).sum()),
        share_error=float(errors.mean()) if len(errors) else np.nan, poses=poses)


def draw_found(top: HeightMap, parts: Sequence[VisiblePart], right: np.ndarray) -> np.ndarray:
    """Draws parts over a height map: yellow outlines, middles green where (n,) `right`, else red.

    Returns:
        (h, w, 3) uint8 BGR.
    """
    picture = draw_heights(top)
    for part in parts:
        outline = _pixels(picture, top, part.outline)
        cv2.polylines(picture, [outline], True, _YELLOW, 1, cv2.LINE_AA)
    for part, is_there in zip(parts, right):
        x, y = _pixels(picture, top, part.position[None])[0].tolist()
        cv2.circle(picture, (x, y), 3, _GREEN if is_there else _RED, -1, cv2.LINE_AA)
    return picture


def draw_poses(picture: np.ndarray, top: HeightMap, parts: Sequence[VisiblePart],
               errors: Sequence[PoseError], mesh: Mesh) -> None:
    """Draws the mesh at the told poses into `draw_found`'s picture: green right, red wrong."""
    posed = [part.pose.T_world_part for part in parts if part.pose is not None]
    for T, error in zip(posed, errors, strict=True):
        corners = _pixels(picture, top, geometry.apply(T, mesh.vertices))[mesh.triangles]
        draw_silhouette(picture, corners, _GREEN if is_right(error) else _RED)


def _pixels(picture: np.ndarray, top: HeightMap, points: np.ndarray) -> np.ndarray:
    """(n, 2) int32 x and y of (n, 3) world points in a picture of the map, whose y is upwards."""
    local = geometry.apply(geometry.inverse(top.T_world_map), points)[:, :2] / top.pitch
    local[:, 1] = top.heights.shape[0] - local[:, 1]
    return np.round(local * picture.shape[1] / top.heights.shape[1]).astype(np.int32)


def format_table(cases: list[VisibleCase]) -> str:
    """The figures, of all scenes and by the kind of container."""
    done = [c for c in cases if not c.refused]
    lines = [f"{len(cases) - len(done)} refused",
             f"{'':10}{'scenes':>7}{'shown':>8}{'told':>8}{'precision':>11}{'mostly':>8}"
             f"{'recall':>8}{'share':>8}{'ms':>7}"]
    groups = {"all": done, **{kind: [c for c in done if c.kind == kind]
                              for kind in sorted({c.kind for c in done})}}
    return "\n".join(lines + [_format_line(name, group) for name, group in groups.items()
                              if group])


def _format_line(title: str, cases: list[VisibleCase]) -> str:
    """Sums over the scenes; the share's error is over the right parts, the time a median."""
    shown, told, right, mostly, found = (
        sum(getattr(c, name) for c in cases)
        for name in ("shown", "told", "right", "mostly_shown", "found"))
    error = sum(c.share_error * c.right for c in cases if c.right) / max(right, 1)
    return (f"{title:10}{len(cases):7}{shown:8}{told:8}{right / max(told, 1):11.3f}{mostly:8}"
            f"{found / max(mostly, 1):8.3f}{error:8.3f}"
            f"{1000 * np.median([c.seconds for c in cases]):7.1f}")
