"""Recordings of training scenes through the whole reconstruction: what the network is fitted to
and its errors are measured on, as at run time.

    python -m stack_counter.train.scans OUT data/train-deep:6 data/train-shallow:27 --workers 2
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import StackCounterError
from stack_counter.gamma_input import stack_maps
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, read_shard, record
from stack_counter.train.heights import Sample, form_of, read_samples, write_samples
from stack_counter.types import StackVolume

_VIEWS = 12
_FOUND = {"bin": "box", "tray": "box", "cylinder": "round", "bowl": "round", "cup": "round",
          "bag": "free", "none": "none"}  # what the reconstruction makes of a kind


@dataclass(frozen=True)
class Scan:
    """A fused scene: its maps with the truth, and how V came out (m3)."""

    sample: Sample
    true_volume: float
    volume: float
    volume_std: float
    found: bool  # the container, for what it is


def reconstruct(scene: Scene, seed: int = 0, views: int = _VIEWS) -> StackVolume:
    """V of a noisy recording of a scene, with the default settings.

    Raises:
        StackCounterError: the scan is refused.
    """
    stack = StackCounter(ReconstructorConfig())
    stack.reset(scene.truth.unit_volume)
    for view in record(scene, views, seed, color=False):
        stack.add_view(view)
    return stack.volume()


def scan(scene: Scene) -> Scan | None:
    """One scene; None, with a line on stderr, if it is refused."""
    truth, name = scene.truth, f"{scene.seed}:{scene.index}"
    try:
        volume = reconstruct(scene)
        maps = stack_maps(volume, truth.unit_volume)
    except StackCounterError as error:
        print(f"scene {name}: {error}", file=sys.stderr)
        return None
    of = Sample(maps, truth.gamma, form_of(scene), truth.unit_volume ** (1 / 3), name,
                scene.shape.family, scene.container.kind, truth.count, truth.fill)
    return Scan(of, truth.stack_volume, volume.stack_volume, volume.stack_volume_std,
                volume.container.kind == _FOUND[scene.container.kind])


def read_scans(folder: Path) -> list[Scan]:
    """All scans kept in a folder by this module's command."""
    scans = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as file:
            more = file["more"]
        scans += [Scan(sample, true, volume, std, bool(found))
                  for sample, (true, volume, std, found) in zip(read_samples(path), more)]
    return scans


def _keep(job: tuple[Path, int, Path]) -> None:
    path, step, out = job
    scenes = [s for s in read_shard(path) if s.truth.count and s.index % step == 0]
    scans = [done for scene in scenes if (done := scan(scene))]
    if scans:
        write_samples(out, [s.sample for s in scans], more=np.array(
            [(s.true_volume, s.volume, s.volume_std, s.found) for s in scans]))


def main() -> int:
    """Reconstructs every `step`-th scene of each folder; resumes where it stopped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="+", metavar="DIR:STEP")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    jobs = []
    for text in options.scenes:
        folder, _, step = text.rpartition(":")
        jobs += [(path, int(step), options.out / f"{Path(folder).name}_{path.stem}.npz")
                 for path in sorted(Path(folder).glob("shard_*.npz"))]
    jobs = [job for job in jobs if not job[2].exists()]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for _ in tqdm(pool.map(_keep, jobs), total=len(jobs), unit=" shards"):
            pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
