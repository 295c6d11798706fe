"""Makes many scenes: resumes where it stopped; what lies in a shard depends on the seed alone."""

from __future__ import annotations

import json
import logging
import os
import shutil
import time
from collections import Counter
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path

from tqdm import tqdm

from stack_counter.errors import StackCounterError
from stack_counter.sim.piles import make_scene
from stack_counter.sim.recipes import Recipe
from stack_counter.sim.scene import SceneError
from stack_counter.sim.shapes.library import load_shapes
from stack_counter.sim.shards import LIBRARY, SCENES, read_shard, shard_path, write_shard

_LOG = logging.getLogger(__name__)
_LIBRARY_PIECES = 5000  # convex pieces a scene in a test set, which is small: it may take longer
_LOST_POOLS = 5  # killed workers after which a run gives up


def simulate(out: Path, scenes: int, workers: int, seed: int, plan: str = "mixed",
             library: Path | None = None) -> None:
    """Makes scenes 0 to `scenes` - 1 that are not there yet; logs to `simulate.log` in `out`.

    Args:
        out: folder of the shards.
        workers: processes.
        plan: containers and fills, a name in `recipes.PLANS`.
        library: file of the parts to take, which is copied to `out`; None for the training
            families.

    Raises:
        ShapeError: the library is damaged.
        SceneError: some scenes could not be made; the others are there.
    """
    recipe = Recipe(plan)
    if library is not None:
        recipe = Recipe(plan, tuple(load_shapes(library)), _LIBRARY_PIECES)
    out.mkdir(parents=True, exist_ok=True)
    if library is not None and library.resolve() != (out / LIBRARY).resolve():
        shutil.copyfile(library, out / LIBRARY)
    sizes = {n: min(SCENES, scenes - n * SCENES) for n in range(-(-scenes // SCENES))}
    missing = {n for n, size in sizes.items() if not _is_there(shard_path(out, n), size)}
    failed: dict[int, str] = {}
    with tqdm(total=scenes, initial=scenes - sum(sizes[n] for n in missing), unit=" scenes",
              smoothing=0.05) as bar:
        for _ in range(_LOST_POOLS):
            done = _run_pool(out, {n: sizes[n] for n in sorted(missing - set(failed))}, workers,
                             seed, recipe, failed, bar)
            missing -= done
            if missing <= set(failed):
                break
            _LOG.error("a worker was killed; %d shards begin again", len(missing))
    if missing:
        why = next(iter(failed.values()), "workers were killed too often")
        raise SceneError(f"{len(missing)} of {len(sizes)} shards in {out} are missing: {why}")


def _run_pool(out: Path, sizes: dict[int, int], workers: int, seed: int, recipe: Recipe,
              failed: dict[int, str], bar: tqdm) -> set[int]:
    """Numbers of the shards made until all are, or a worker is killed; `failed` gets reasons."""
    done = set()
    # Spawned: a forked one would inherit the threads of whatever was loaded before.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool, \
            open(out / "simulate.log", "a", buffering=1) as log:
        jobs: dict[Future, int] = {pool.submit(_make, out, n, size, seed, recipe): n
                                   for n, size in sizes.items()}
        for job in as_completed(jobs):
            number = jobs[job]
            try:
                log.write(json.dumps(job.result()) + "\n")
                done.add(number)
                bar.update(sizes[number])
            except BrokenProcessPool:
                continue
            except (StackCounterError, OSError) as error:
                _LOG.error("shard %d: %s", number, error)
                failed[number] = str(error)
    return done


def _make(out: Path, number: int, size: int, seed: int, recipe: Recipe) -> dict:
    """Makes one shard; a line for the log."""
    begin, skipped = time.time(), Counter[str]()
    first = number * SCENES
    scenes = [make_scene(seed, i, recipe, skipped) for i in range(first, first + size)]
    write_shard(shard_path(out, number), scenes, skipped)
    return {"shard": number, "scenes": size, "parts": sum(len(s.poses) for s in scenes),
            "seconds": round(time.time() - begin, 1), "worker": os.getpid(),
            "skipped": dict(skipped)}


def _is_there(path: Path, size: int) -> bool:
    if not path.exists():
        return False
    try:
        return len(read_shard(path)) == size
    except SceneError as error:
        _LOG.error("%s; it is made again", error)
        return False
