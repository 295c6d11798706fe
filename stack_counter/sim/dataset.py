"""Makes many scenes: resumes where it stopped; scene i depends on (seed, i) alone."""

from __future__ import annotations

import logging
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from tqdm import tqdm

from stack_counter.errors import StackCounterError
from stack_counter.sim.piles import make_scene

_LOG = logging.getLogger(__name__)


def scene_path(out: Path, index: int) -> Path:
    """File of scene `index`."""
    return out / f"scene_{index:06d}.npz"


def simulate(out: Path, scenes: int, workers: int, seed: int) -> Counter[str]:
    """Makes scenes 0 to `scenes` - 1 that are not there yet.

    Args:
        out: folder for one file a scene.
        workers: processes.

    Returns:
        Failed tries by reason.
    """
    out.mkdir(parents=True, exist_ok=True)
    missing = [i for i in range(scenes) if not scene_path(out, i).exists()]
    skipped: Counter[str] = Counter()
    with ProcessPoolExecutor(workers) as pool, tqdm(total=scenes, initial=scenes - len(missing),
                                                    unit=" scenes") as bar:
        jobs = {pool.submit(_make, out, seed, i): i for i in missing}
        for job in as_completed(jobs):
            try:
                skipped.update(job.result())
            except BrokenProcessPool:
                raise
            except (StackCounterError, OSError) as error:
                _LOG.warning("scene %d: %s", jobs[job], error)
                skipped["failed"] += 1
            bar.update()
    return skipped


def _make(out: Path, seed: int, index: int) -> Counter[str]:
    skipped: Counter[str] = Counter()
    make_scene(seed, index, skipped).save(scene_path(out, index))
    return skipped
