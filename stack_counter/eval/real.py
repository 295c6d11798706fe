# SPDX-License-Identifier: Apache-2.0
"""Counts of real scenes that somebody has counted, by the pipeline or by a baseline of the paper.

    stack-counter evaluate real SCENE ...
    stack-counter evaluate real SCENE ... --baseline human
    stack-counter evaluate real SCENE ... --baseline vlm --baseline-weights DIR

A scene is a folder of 3DC-Real, or one like it: transforms.json, pictures, label images, and an
info.json with gt_count and unit_volume. A baseline sees the view with the most part pixels.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

from stack_counter.bag.replay import count_bag
from stack_counter.config import CollectorConfig
from stack_counter.errors import BagError, ConfigError, ScanError
from stack_counter.eval.common import metrics
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.picture_cases import (
    PictureCase,
    check_baseline_options,
    format_baseline,
    format_not_run,
    load_once,
)
from stack_counter.eval.common.real_scenes import (
    RealScene,
    crop_key_view,
    imported,
    read_real_scene,
)
from stack_counter.picture_baselines import KINDS
from stack_counter.picture_baselines.people import People
from stack_counter.picture_baselines.picture import Picture
from stack_counter.tasks.progress import progress, write_line
from stack_counter.types import Reason


@dataclass(frozen=True)
class RealCase:
    """One scene by the pipeline.

    Attributes:
        scene: its name.
        true: number of parts.
        count, low, high: the estimate and its interval; None if the scan was refused.
        gamma, volume_m3: gamma and V; None likewise.
        seconds: time that it took, without the import.
        status, reasons: of the count; empty if it was refused.
        refused: why there is no count; empty: there is one.
    """

    scene: str
    true: int
    count: int | None = None
    low: int | None = None
    high: int | None = None
    gamma: float | None = None
    volume_m3: float | None = None
    seconds: float = 0.0
    status: str = ""
    reasons: tuple[Reason, ...] = ()
    refused: str = ""


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code.

    Raises:
        BagError, ConfigError: a scene does not state its truth, or options do not go together.
        WeightsError: the baseline cannot be loaded.
    """
    check_baseline_options(options)
    if (options.exemplars or options.pictures) and not options.baseline:
        raise ConfigError("--exemplars and --pictures are of baselines; expected --baseline too")
    scenes = [read_real_scene(folder) for folder in options.scenes]
    cases: list[RealCase] | list[PictureCase]
    if not options.baseline:
        cases = [count_scene(scene) for scene in progress(scenes, "counts", "scenes")]
        print(format_table(cases))
    elif not options.baseline_weights and options.baseline != "human":
        print(format_not_run(options.baseline))
        return 0
    else:
        cases = measure_baseline(options, scenes)
        print(format_baseline(options.baseline, cases))
    if options.json:
        write_figures(options.json, cases)
    return 0


def count_scene(scene: RealScene) -> RealCase:
    """Counts a scene as `replay` counts its bag; a refused one is told in a line."""
    start = time.perf_counter()
    try:
        with imported(scene) as bag:
            start = time.perf_counter()
            result = count_bag(bag, unit_volume=scene.unit_volume)
    except (BagError, ScanError) as error:
        write_line(f"{scene.name}: {error}")
        return RealCase(scene.name, scene.count, seconds=time.perf_counter() - start,
                        refused=str(error))
    return RealCase(scene.name, scene.count, result.count, *result.count_interval, result.gamma,
                    result.volume.stack_volume, time.perf_counter() - start, result.status,
                    result.reasons)


def format_table(cases: list[RealCase]) -> str:
    """The paper's errors over all scenes, and a line for each."""
    done = [c for c in cases if c.count is not None]
    lines = [f"{len(cases)} real scenes, {len(cases) - len(done)} refused"]
    if done:
        true, guess = (np.array([getattr(c, name) for c in done], float)
                       for name in ("true", "count"))
        held = sum(c.low <= c.true <= c.high for c in done)
        lines.append(f"NAE {metrics.nae(true, guess):.3f}, SRE {metrics.sre(true, guess):.3f}, "
                     f"MAE {metrics.mae(true, guess):.1f}, sMAPE "
                     f"{metrics.smape(true, guess):.1f}%; {held} of {len(done)} intervals hold")
    return "\n".join([*lines, *map(_format_case, cases)])


def _format_case(case: RealCase) -> str:
    """The line of one scene."""
    if case.count is None or case.volume_m3 is None:
        return f"{case.scene}: refused: {case.refused}"
    return (f"{case.scene}: {case.count} [{case.low}, {case.high}] for {case.true} "
            f"({case.count / case.true - 1:+.1%}), gamma {case.gamma:.3f}, V "
            f"{case.volume_m3 * 1e6:.0f} cm3, {case.status}, {case.seconds:.0f} s")


def measure_baseline(options: argparse.Namespace, scenes: list[RealScene]) -> list[PictureCase]:
    """Measures a baseline on the scenes that have a key view, the others are told in a line.

    Raises:
        ConfigError: the file of exemplars cannot be used.
        WeightsError: the baseline cannot be loaded.
    """
    name, paths = options.baseline, tuple(options.baseline_weights)
    if name == "human":
        return _look_up_guesses(scenes, paths)
    exemplars = read_exemplars(options.exemplars)
    load_once(name, paths)  # complains before any scene is read
    cases = []
    for scene in progress(scenes, "pictures", "scenes"):
        try:
            cases.append(_measure_picture(scene, name, paths, exemplars, options.pictures))
        except (BagError, ScanError) as error:
            write_line(f"{scene.name}: {error}")
    return cases


def _look_up_guesses(scenes: list[RealScene], paths: tuple[Path, ...]) -> list[PictureCase]:
    """What people guessed, by a file or else by the scenes themselves."""
    people = People(*paths) if paths else None
    return [PictureCase(s.name, s.part, "", s.count, None,
                        people.guesses_for(s.name) if people else list(s.guesses), 0.0)
            for s in scenes]


def _measure_picture(scene: RealScene, name: str, paths: tuple[Path, ...],
                     exemplars: dict[str, np.ndarray], pictures: Path | None) -> PictureCase:
    """A baseline's guesses for a scene; its key view is written to the folder `pictures`, if any.

    Raises:
        BagError, ScanError: there is no key view, or no V where that is needed.
    """
    parts_of_one = 1.0  # what the guess is multiplied with
    with imported(scene) as bag:
        color = crop_key_view(bag, CollectorConfig())
        if KINDS[name].gives == "gamma":
            volume = count_bag(bag, unit_volume=scene.unit_volume).volume
            parts_of_one = volume.stack_volume / scene.unit_volume
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(pictures / f"{scene.name}.png"), color[..., ::-1])
    start = time.perf_counter()
    boxes = exemplars.get(scene.name, np.zeros((0, 4)))
    guesses = load_once(name, paths).guess(Picture(scene.name, color, scene.part, boxes))
    return PictureCase(scene.name, scene.part, "", scene.count, None,
                       [parts_of_one * guess for guess in guesses], time.perf_counter() - start)


def read_exemplars(path: Path | None) -> dict[str, np.ndarray]:
    """Reads (k, 4) boxes x0, y0, x1, y1 by scene, pixels of the key view, from YAML; None: none.

    Raises:
        ConfigError: the file is missing or holds anything else.
    """
    if path is None:
        return {}
    try:
        return {str(scene): np.array(boxes, float).reshape(-1, 4)
                for scene, boxes in yaml.safe_load(path.read_text()).items()}
    except (OSError, AttributeError, TypeError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: {' '.join(str(error).split())}; expected boxes [x0, y0, x1, "
                          "y1] by scene") from error
