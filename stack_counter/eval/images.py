# SPDX-License-Identifier: Apache-2.0
"""Pictures without depth: errors of stereo's depth and of V on simulated colour recordings.

Labels are rendered at the true poses, as a perfect segmenter gives them; everything else gets the
poses that the robot reports. Beside V by stereo stand V of the labels' hull alone and V of ideal
depth at the same poses, which has the errors of the container's fit but none of stereo.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.sets import find_set_folder
from stack_counter.pipeline import StackCounter
from stack_counter.reconstruction import PictureReconstruction
from stack_counter.sim import DepthCamera, Scene, read_scenes, record
from stack_counter.tasks.progress import progress, write_line
from stack_counter.types import PARTS, Reason, View

IDEAL = DepthCamera(sigma_m=0.0, sigma_per_m2=0.0, step_m=1e-6)
# A depth nearer than this to the truth, metres, is right; chosen.
_CLOSE_M = 0.003
_SOURCES = ("pictures", "hull", "ideal_depth")


@dataclass(frozen=True)
class DepthErrors:
    """Errors of stereo's depth on the pixels of parts.

    Attributes:
        median_m, bias_m: median absolute error, and median error, where depth is known, metres.
        known: share of the pixels whose depth is known.
        right: share of the pixels whose depth is known within 3 mm.
    """

    median_m: float
    bias_m: float
    known: float
    right: float


@dataclass(frozen=True)
class PictureErrors:
    """One scene.

    Attributes:
        index, kind: number of the scene, and kind of its container.
        found: kind of the container that was found; `hull` where stereo gave no depth.
        reasons: why V may be wrong.
        depth: errors of stereo's depth; None where it gave none and the hull stands in its place.
        errors: relative error of V by source; None where there is no V.
    """

    index: int
    kind: str
    found: str
    reasons: tuple[Reason, ...]
    depth: DepthErrors | None
    errors: dict[str, float | None]


def run(args: argparse.Namespace) -> int:
    """Records, measures and prints, about a minute a scene; returns the exit code."""
    rows = []
    scenes = itertools.islice(read_scenes(find_set_folder(args.set)), args.scenes)
    for scene in progress(scenes, "volumes", "scenes", args.scenes):
        rows.append(evaluate_pictures(scene, record(scene, args.views, args.seed, camera=IDEAL,
                                           labels=True)))
        write_line(format_row(rows[-1]))
    summary = summarise_errors(rows)
    for name, figures in summary.items():
        print(f"{name}: " + ", ".join(f"{key} {value:.3g}" for key, value in figures.items()))
    if args.json:
        write_figures(args.json, {"summary": summary, "scenes": rows})
    return 0


def evaluate_pictures(scene: Scene, views: list[View]) -> PictureErrors:
    """Errors on one recording: views with colour, ideal depth and labels."""
    # V of the labels' hull, and of ideal depth
    pictures = [replace(view, depth=None) for view in views]
    hull = _measure_volume([replace(view, color=None) for view in pictures])
    ideal = _measure_volume([replace(view, labels=None) for view in views])
    # V of stereo's depth; where stereo measures too little, the hull stands in its place
    scan = PictureReconstruction(ReconstructorConfig())
    for view in pictures:
        scan.add_view(view)
    result = scan.measure_volume(taught=None)
    found, stack_volume, depth = "hull", hull, None
    reasons: tuple[Reason, ...] = (Reason.NO_DEPTH,)
    if scan.stereo is not None:
        found, reasons, stack_volume = result.container.kind, result.reasons, result.stack_volume
        depth = measure_depth_errors(scan.stereo.views, views)
    by_source = {"pictures": stack_volume, "hull": hull, "ideal_depth": ideal}
    truth = scene.truth.stack_volume
    return PictureErrors(
        scene.index, scene.container.kind, found, reasons, depth,
        {name: None if v is None else v / truth - 1 for name, v in by_source.items()})


def _measure_volume(views: list[View]) -> float | None:
    """V by the pipeline, m3; None if the scan is refused."""
    counter = StackCounter(ReconstructorConfig())
    for view in views:
        counter.add_view(view)
    try:
        return counter.volume().stack_volume
    except ScanError:
        return None


def measure_depth_errors(views: Sequence[View], ideal: Sequence[View]) -> DepthErrors:
    """Errors of depth on part pixels against the same views with ideal depth, where that has any.

    Both have labels and depth, 0 unknown, at the same pixels.
    """
    by_view = []
    for view, true in zip(views, ideal):
        assert view.depth is not None and true.depth is not None  # both have depth
        parts = (true.labels == PARTS) & (true.depth > 0)
        by_view.append(np.where(view.depth > 0, view.depth - true.depth, np.nan)[parts])
    errors = np.concatenate(by_view)
    known = errors[np.isfinite(errors)]
    median, bias = (float(np.median(x)) if len(known) else float("nan")
                    for x in (np.abs(known), known))
    return DepthErrors(median, bias, len(known) / max(len(errors), 1),
                       float(np.mean(np.abs(errors) <= _CLOSE_M)))


def summarise_errors(rows: Sequence[PictureErrors]) -> dict[str, dict[str, float]]:
    """Sums up the errors of V by source, and the means of the depth errors.

    Errors of V are given over all scenes and by kind of container: mean absolute relative error,
    bias and 95th percentile.
    """
    summary = {}
    for kind in ("all", *sorted({row.kind for row in rows})):
        chosen = [row for row in rows if kind in ("all", row.kind)]
        for source in _SOURCES:
            errors = [e for row in chosen if (e := row.errors[source]) is not None]
            if errors:
                summary[f"{source}, {kind}"] = {
                    "mean_abs": float(np.mean(np.abs(errors))), "bias": float(np.mean(errors)),
                    "p95": float(np.percentile(np.abs(errors), 95)), "scenes": len(errors)}
    depth = [asdict(row.depth) for row in rows if row.depth is not None]
    if depth:
        summary["depth"] = {name: float(np.mean([d[name] for d in depth])) for name in depth[0]}
    return summary


def format_row(row: PictureErrors) -> str:
    """The errors of one scene in a line."""
    errors = ", ".join(f"{name} {'none' if e is None else f'{e:+.1%}'}"
                       for name, e in row.errors.items())
    depth = row.depth and (f"; depth off by {1e3 * row.depth.median_m:.2f} mm, known on "
                           f"{row.depth.known:.0%}")
    return (f"scene {row.index} {row.kind}, found {row.found} ({', '.join(row.reasons)}): "
            f"V {errors}{depth or ''}")
