# SPDX-License-Identifier: Apache-2.0
"""Scenes of a set through a baseline that counts from one colour picture.

Every scene's key view is rendered, a second each. The guesses are held against the number of all
parts and against the number of those that show in the picture, which the simulator knows.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from stack_counter.errors import ConfigError, ScanError, ViewError
from stack_counter.eval.common import metrics
from stack_counter.eval.common.cases import measure_volume
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.sets import read_filled_scenes
from stack_counter.picture_baselines import KINDS, load_baseline
from stack_counter.picture_baselines.picture import Picture, PictureBaseline
from stack_counter.sim import KeyPicture, Scene, SceneError, picture_key_view
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks

_SEED = 0  # of the recordings, as of `cases`
_EXEMPLARS = 3  # boxes that a user draws


@dataclass(frozen=True)
class PictureCase:
    """One picture: its truth and the guesses.

    Attributes:
        scene: number of a simulated scene, or name of a real one.
        family: of the part.
        kind: of the container.
        count: true number of parts.
        visible: number of those that the picture shows; None: nobody has counted them.
        guesses: of the number of parts; none if there was no answer.
        seconds: time that they took.
    """

    scene: str
    family: str
    kind: str
    count: int
    visible: int | None
    guesses: list[float]
    seconds: float


def check_baseline_options(options: argparse.Namespace) -> None:
    """Refuses weights of a baseline that is not named.

    Raises:
        ConfigError: there are such.
    """
    if options.baseline_weights and not options.baseline:
        raise ConfigError("--baseline-weights without --baseline; expected one of "
                          f"{', '.join(KINDS)}")


def report_baseline(options: argparse.Namespace) -> int:
    """Measures one baseline, prints its rows and writes its cases; returns the exit code.

    Raises:
        ConfigError: an option that is the pipeline's alone is given.
    """
    if options.weights or options.plot:
        raise ConfigError("--weights and --plot are the pipeline's; expected neither with "
                          f"--baseline {options.baseline}")
    if not options.baseline_weights:
        print(f"{options.set}: counts from one picture\n{format_not_run(options.baseline)}")
        return 0
    load_once(options.baseline, tuple(options.baseline_weights))  # complains before all else
    scenes = read_filled_scenes(options.set, options.scenes)
    jobs = [(scene, options.baseline, tuple(options.baseline_weights), options.views,
             options.depth) for scene in scenes]
    cases = [case for case in progress(map_tasks(_measure_job, jobs, Workers.of(options)),
                                       "pictures", "scenes", len(jobs)) if case]
    print(f"{options.set}: counts from one picture of {len(cases)} of {len(jobs)} scenes")
    print(format_baseline(options.baseline, cases))
    if options.json:
        write_figures(options.json, cases)
    return 0


def format_not_run(name: str) -> str:
    """The row of a baseline whose weights nobody has named."""
    return f"{KINDS[name].title:24}not run: needs WEIGHTS: {', '.join(KINDS[name].needs)}"


@cache
def load_once(name: str, paths: tuple[Path, ...]) -> PictureBaseline:
    """The baseline of `load_baseline`, kept for the scenes to come.

    Raises:
        WeightsError: as `load_baseline`.
    """
    return load_baseline(name, paths)


def _measure_job(job: tuple) -> PictureCase | None:
    return measure_scene(*job)


def measure_scene(scene: Scene, name: str, paths: tuple[Path, ...], views: int, depth: str
                  ) -> PictureCase | None:
    """Measures one scene; None, with a line, if it is not seen or V is refused.

    V, which gamma is multiplied with, is measured as `depth` of the command says.
    """
    baseline, truth = load_once(name, paths), scene.truth
    try:
        picture = picture_key_view(scene, views, _SEED)
        parts_of_one = 1.0  # what the guess is multiplied with
        if KINDS[name].gives == "gamma":
            parts_of_one = measure_volume(scene, depth, views).stack_volume / truth.unit_volume
    except (SceneError, ScanError, ViewError) as refused:
        print(f"scene {scene.index}: {refused}")
        return None
    shown = show_picture(scene, picture)
    start = time.perf_counter()
    guesses = [parts_of_one * guess for guess in baseline.guess(shown)]
    return PictureCase(str(scene.index), scene.shape.family, scene.container.kind, truth.count,
                       picture.visible_count, guesses, time.perf_counter() - start)


def show_picture(scene: Scene, picture: KeyPicture) -> Picture:
    """What a baseline is shown of a simulated scene."""
    name = scene.shape.family.rpartition("/")[2].replace("_", " ")
    return Picture(str(scene.index), picture.color, name,
                   picture.parts.boxes(picture.parts.visible[:_EXEMPLARS]))


def format_baseline(name: str, cases: list[PictureCase]) -> str:
    """What the baseline sees and learnt from, and its errors against all and visible parts."""
    kind, used = KINDS[name], cases
    silent = sum(not c.guesses for c in cases)
    note = f"{silent} without an answer, taken as 0"
    if name == "human":  # nobody was asked
        used, note = [c for c in cases if c.guesses], f"{silent} without a guess, left out"
    lines = [f"{kind.title} sees: {kind.sees}; learnt from: {kind.learnt_from}", note,
             f"{'':36}{'n':>5}{'NAE':>7}{'SRE':>7}{'MAE':>9}{'sMAPE':>8}{'bias':>8}{'seconds':>9}"]
    seen = [c for c in used if c.visible]
    for title, chosen, true in (("all parts", used, [c.count for c in used]),
                                ("visible parts", seen, [c.visible for c in seen])):
        if chosen:
            lines += _format_rows(f"{kind.title}, {title}", chosen, np.array(true, float))
    return "\n".join(lines)


def _format_rows(title: str, cases: list[PictureCase], true: np.ndarray) -> list[str]:
    """The line of errors; where several people guessed, also that of their mean guess.

    Every guess counts as one of the first line.
    """
    guesses = [c.guesses or [0.0] for c in cases]
    repeated = np.repeat(true, [len(g) for g in guesses])
    seconds = float(np.median([c.seconds for c in cases]))
    lines = [_format_errors(title, repeated, np.concatenate(guesses), seconds)]
    if len(repeated) > len(true):
        means = np.array([np.mean(g) for g in guesses])
        lines.append(_format_errors(f"{title}, mean guess", true, means, seconds))
    return lines


def _format_errors(title: str, true: np.ndarray, guess: np.ndarray, seconds: float) -> str:
    return (f"{title:36}{len(true):5}{metrics.nae(true, guess):7.3f}"
            f"{metrics.sre(true, guess):7.3f}{metrics.mae(true, guess):9.1f}"
            f"{metrics.smape(true, guess):8.1f}{np.mean(guess / true - 1):+8.3f}{seconds:9.3f}")
