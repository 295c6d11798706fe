# SPDX-License-Identifier: Apache-2.0
"""Scenes of a set through the pipeline and several estimators, once for all figures."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from stack_counter.config import CounterConfig
from stack_counter.counting import make_count
from stack_counter.errors import ScanError, ViewError
from stack_counter.eval.common.case import Case, Guess
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.plot import plot_complexity
from stack_counter.eval.common.sets import read_filled_scenes
from stack_counter.occupancy import OccupancyEstimator, make_estimator
from stack_counter.occupancy.known_form import form_of_mesh
from stack_counter.sim import (
    Scene,
    Shape,
    ideal_surface,
    reconstruct,
    reconstruct_from_pictures,
    surface_grid,
)
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.types import Container, HeightMap, KnownForm, StackVolume, ViewTally

# Rows of the tables, and the estimators that they stand for.
ROWS = {"Mean": "prior", "DepthExtrapolated": "depth_extrapolated",
        "DepthCorrected": "depth_corrected", "direct count": "direct", "ours": "network"}
# Bounds of the fill by which the tables group scenes; seed of the recordings. Chosen.
_FILLS, _SEED = ((0.0, 0.25), (0.25, 0.6), (0.6, 9.0)), 0
_SEEN = {"pictures": "pictures without depth"}


def report_cases(options: argparse.Namespace, title: str,
                 format_table: Callable[[list[Case]], str]) -> int:
    """Measures, prints the table under a title and writes the cases; returns the exit code."""
    cases = measure_cases(options)
    seen = _SEEN.get(options.depth, f"{options.depth} depth")
    print(f"{options.set}: {title} of {len(cases)} scenes, {seen}")
    print(format_table(cases))
    if options.json:
        write_figures(options.json, cases)
    if options.plot:
        plot_complexity(cases, f"{options.set}, {seen}", options.plot)
    return 0


def measure_cases(options: argparse.Namespace) -> list[Case]:
    """Measures all scenes of the set that hold parts."""
    jobs = [(scene, options.depth, options.views, options.confidence, options.weights)
            for scene in read_filled_scenes(options.set, options.scenes)]
    return list(progress(map_tasks(_measure_job, jobs, Workers.of(options)), "cases", "scenes",
                         len(jobs)))


def _measure_job(job: tuple) -> Case:
    return _measure_case(*job)


@cache
def _load_estimator(name: str, weights: Path | None) -> OccupancyEstimator:
    return make_estimator(CounterConfig(
        estimator=name, weights=str(weights) if weights and name == "network" else ""))


def _measure_case(scene: Scene, depth: str, views: int, confidence: float,
                  weights: Path | None) -> Case:
    """One scene by all estimators, through the pipeline or as it is: `depth` as of the command."""
    truth, guesses, volume_error = scene.truth, {}, np.nan
    try:
        volume = measure_volume(scene, depth, views)
        volume_error = volume.stack_volume / truth.stack_volume - 1
        for row, estimator in _estimators(scene.shape, weights).items():
            guesses[row] = _guess_count(estimator, volume, truth.unit_volume, confidence)
    except (ScanError, ViewError) as refused:
        print(f"scene {scene.index}: {refused}")
        guesses = {}
    return Case(scene.index, scene.shape.family, scene.container.kind, truth.count, truth.gamma,
                truth.fill, scene.shape.complexity, volume_error, guesses)


def measure_volume(scene: Scene, depth: str, views: int) -> StackVolume:
    """V and surface through the pipeline or as they are: `depth` as of the command.

    Raises:
        StackCounterError: the scan is refused.
    """
    if depth == "ideal":
        return ideal_volume(scene)
    if depth == "pictures":
        return reconstruct_from_pictures(scene, views)
    return reconstruct(scene, _SEED, views)


def _estimators(shape: Shape, weights: Path | None) -> dict[str, OccupancyEstimator]:
    """Estimators by row; ours also as it knows the part, if it reads what is known of its form."""
    estimators = {row: _load_estimator(name, weights) for row, name in ROWS.items()}
    form, ours = form_of_mesh(shape.vertices, shape.faces), estimators["ours"]
    for row, known in (("ours, size known", KnownForm(form.outer_size_m)),
                       ("ours, mesh known", form)):
        if (knowing := ours.knowing(known)) is not ours:
            estimators[row] = knowing
    return estimators


def _guess_count(estimator: OccupancyEstimator, volume: StackVolume, unit_volume: float,
                 confidence: float) -> Guess:
    start = time.perf_counter()
    estimate = estimator.estimate(volume, unit_volume)
    count = make_count(volume, unit_volume, estimate, confidence)
    return Guess(estimate.gamma, count.count, *count.count_interval,
                 time.perf_counter() - start, count.reasons, count.status)


def ideal_volume(scene: Scene) -> StackVolume:
    """The result of a perfect reconstruction: the true V and the surface as cast."""
    surface, grid = ideal_surface(scene), surface_grid(scene)
    length = scene.truth.unit_volume ** (1 / 3)
    T_world_map = grid.T_world_map(scene.container.T_world_container)
    top, inner = (HeightMap(T_world_map, grid.pitch,
                            np.where(surface.valid, heights * length, np.nan).astype(np.float32))
                  for heights in (surface.top, surface.inner))
    container = Container("none" if scene.container.kind == "none" else "box", np.eye(4))
    return StackVolume(
        stamp_ns=0, stack_volume=scene.truth.stack_volume, stack_volume_std=0.0,
        container=container, fill_level=(0, 0, 0), coverage=1.0, top=top, inner=inner,
        key_view=None, views=ViewTally())


def group_cases(cases: list[Case]) -> dict[str, list[Case]]:
    """The cases by container kind, by fill and by complexity; empty groups are left out."""
    groups = {kind: [c for c in cases if c.kind == kind]
              for kind in sorted({c.kind for c in cases})}
    for low, high in _FILLS:
        groups[f"fill {low:g}-{high:g}"] = [c for c in cases if low <= c.fill < high]
    thirds = np.quantile([c.complexity for c in cases], [1 / 3, 2 / 3])
    for i, name in enumerate(("simple", "middling", "complex")):
        groups[name] = [c for c in cases if np.searchsorted(thirds, c.complexity) == i]
    return {name: group for name, group in groups.items() if group}
