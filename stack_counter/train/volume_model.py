# SPDX-License-Identifier: Apache-2.0
r"""Measures bias and errors of V on training scenes: how each scan differs from its true surface.

    python -m stack_counter.train.volume_model data/train-deep data/train-shallow --scenes 300 \
        --log volume.jsonl --out volume.json

Every scene is recorded with noise, by an arc of views and by one camera above; every third with a
noisier camera, which tells apart what grows with the noise; the first few also in pictures alone,
which takes a minute each. The log holds one line a scan: what each number rests on, and what need
not be measured again when the command goes on.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from stack_counter.errors import ConfigError, StackCounterError
from stack_counter.files import write_atomically
from stack_counter.fusion.volume_model import (
    FORMAT,
    VolumeModel,
    read_volume_model,
    volume_model,
)
from stack_counter.sim import Scene, read_shard
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.tasks.progress import progress
from stack_counter.train.data.volume_errors import (
    ARC,
    ONE_SIDE,
    PICTURES,
    VolumeErrors,
    check_formula,
    measure_volume_errors,
)
from stack_counter.train.data.volume_fit import MeasuredNumber, measure_numbers


@dataclass(frozen=True)
class ScanPlanSettings:
    """Which scenes are recorded, and how; all chosen.

    Attributes:
        scenes_per_shard: number of scenes that are taken of a file, whose scenes share parts.
        noisy_every: of so many scenes one is recorded with a noisier camera.
        max_noise: largest noise of that, relative to the default camera's.
    """

    scenes_per_shard: int = 6
    noisy_every: int = 3
    max_noise: float = 3.0


SETTINGS = ScanPlanSettings()


@dataclass(frozen=True, eq=False)
class ScanJob:
    """One scan to be made.

    Attributes:
        scene: what is recorded.
        views: how: `arc`, `one side` or `pictures`.
        seed: seed of the recording.
        noise_factor: noise of the depth camera relative to the default one.
    """

    scene: Scene
    views: str
    seed: int
    noise_factor: float

    @property
    def key(self) -> tuple[str, str]:
        """Scene and views, by which the log knows the scan."""
        return f"{self.scene.seed}:{self.scene.index}", self.views


def plan_scans(folders: Sequence[Path], scenes: int, pictures: int, seed: int
               ) -> Iterator[ScanJob]:
    """Draws scenes from the folders in turn, and the scans to be made of each.

    Args:
        folders: training scenes.
        scenes: number of scenes.
        pictures: number of scenes, the first ones, that are recorded in pictures too.
        seed: seed of the drawing and the recordings.

    Raises:
        ConfigError: a folder is a test set or holds no scenes.
    """
    random = np.random.default_rng(seed)
    shards = [random.permutation(_shards(folder)) for folder in folders]
    in_turn = [paths[turn] for turn in range(max(map(len, shards))) for paths in shards
               if turn < len(paths)]
    number = 0
    for path in in_turn:
        held = [scene for scene in read_shard(path) if scene.truth.count]
        chosen = random.permutation(len(held))[:SETTINGS.scenes_per_shard]
        for scene in [held[i] for i in sorted(chosen)]:
            if number == scenes:
                return
            noisy = number % SETTINGS.noisy_every == SETTINGS.noisy_every - 1
            noise_factor = SETTINGS.max_noise ** random.random() if noisy else 1.0
            number += 1
            yield ScanJob(scene, ARC, seed, noise_factor)
            yield ScanJob(scene, ONE_SIDE, seed, noise_factor)
            if number <= pictures:
                yield ScanJob(scene, PICTURES, seed, 1.0)


def _shards(folder: Path) -> list[Path]:
    """Files of a folder of training scenes.

    Raises:
        ConfigError: it is a test set, or holds none.
    """
    if folder.name.startswith("unseen"):
        raise ConfigError(f"{folder} is a test set; expected training scenes, data/train-*: "
                          "nothing is ever fitted on test sets")
    paths = sorted(folder.glob("shard_*.npz"))
    if not paths:
        raise ConfigError(f"no shard_*.npz in {folder}; expected a folder of training scenes")
    return paths


def run_scan(job: ScanJob) -> dict:
    """Makes one scan; returns its line of the log: `VolumeErrors`, or why it was refused."""
    try:
        errors = measure_volume_errors(job.scene, job.views, job.seed, job.noise_factor)
        check_formula(errors)
    except StackCounterError as error:
        scene, views = job.key
        return {"scene": scene, "views": views, "refused": str(error)}
    return {name: value if isinstance(value, (str, bool)) else float(value)
            for name, value in asdict(errors).items()}


def run_scans(jobs: Sequence[ScanJob], log: Path | None, workers: int
              ) -> tuple[list[VolumeErrors], int]:
    """Makes the scans that the log does not hold yet.

    Args:
        jobs: scans to be made.
        log: file to which each is written as a line of JSON; None for no log.
        workers: number of processes.

    Returns:
        What was measured, of these scans alone, and how many of them were refused.
    """
    lines = map(json.loads, log.read_text().splitlines()) if log and log.exists() else ()
    done = {(line["scene"], line["views"]): line for line in lines}
    missing = [job for job in jobs if job.key not in done]
    with worker_pool(workers) if workers > 1 else nullcontext() as pool:
        results = pool.map(run_scan, missing) if pool else map(run_scan, missing)
        for line in progress(results, "volumes", "scans", len(missing)):
            done[line["scene"], line["views"]] = line
            if log:
                with open(log, "a") as file:
                    file.write(json.dumps(line) + "\n")
    used = [done[job.key] for job in jobs]
    return [VolumeErrors(**line) for line in used if "refused" not in line], \
        sum("refused" in line for line in used)


def file_text(numbers: dict[str, MeasuredNumber], values: VolumeModel, measurement: dict) -> str:
    """Content of a file of weights that `read_volume_model` reads.

    Args:
        numbers: as measured; those that are not there stand as null beside their value.
        values: what the run time is to use.
        measurement: how the numbers were measured.
    """
    entries = {}
    for name, value in asdict(values).items():
        number = numbers.get(name)
        entries[name] = {"value": value, **(asdict(number) if number else {
            "measured": None, "std_error": None, "scans": 0})}
    return json.dumps({"format": FORMAT, "measurement": measurement, "numbers": entries},
                      indent=1) + "\n"


def table(numbers: dict[str, MeasuredNumber], values: VolumeModel) -> str:
    """One line a number: the value kept, what was measured, and how far apart they are."""
    lines = [f"{'':28}{'value':>10}{'measured':>10}{'+-':>10}{'scans':>7}"]
    for field in fields(VolumeModel):
        value, number = getattr(values, field.name), numbers.get(field.name)
        line = f"{field.name:28}{value:10.5f}"
        if number:
            apart = abs(value - number.measured) > 3 * number.std_error
            line += f"{number.measured:10.5f}{number.std_error:10.5f}{number.scans:7}" \
                    f"{'  apart' * apart}"
        lines.append(line)
    return "\n".join(lines)


def main() -> int:
    """Makes the scans, fits the numbers, prints and writes them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="training scenes")
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    parser.add_argument("--values", type=Path, metavar="FILE",
                        help="keep the values of this file, and write what is measured beside "
                             "them; else what is measured becomes the values")
    parser.add_argument("--log", type=Path, metavar="FILE", help="one line a scan; goes on there")
    parser.add_argument("--scenes", type=int, default=300, metavar="N")
    parser.add_argument("--pictures", type=int, default=8, metavar="N",
                        help="of them recorded in pictures too")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--workers", type=int, default=1, metavar="W")
    options = parser.parse_args()
    jobs = list(plan_scans(options.folders, options.scenes, options.pictures, options.seed))
    errors, refused = run_scans(jobs, options.log, options.workers)
    numbers = measure_numbers(errors, volume_model(), options.seed)
    measured = {name: max(number.measured, 0.0) for name, number in numbers.items()}
    kept = read_volume_model(options.values) if options.values \
        else replace(volume_model(), **measured)
    print(table(numbers, kept))
    write_atomically(options.out, file_text(numbers, kept, {
        "command": "python -m stack_counter.train.volume_model "
                   f"{' '.join(map(str, options.folders))} --scenes {options.scenes} "
                   f"--pictures {options.pictures} --seed {options.seed}",
        "seed": options.seed, "scenes": options.scenes, "scans": len(errors),
        "refused": refused}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
