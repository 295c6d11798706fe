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
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path

from tqdm import tqdm

from stack_counter.errors import StackCounterError
from stack_counter.sim.physics.drop import make_scene
from stack_counter.sim.physics.recipes import Recipe
from stack_counter.sim.scenes.scene import SceneError
from stack_counter.sim.scenes.shards import (
    LIBRARY_FILE,
    SCENES_PER_SHARD,
    read_shard,
    shard_path,
    write_shard,
)
from stack_counter.sim.shapes.library import load_shapes

_LOG = logging.getLogger(__name__)
RUN = "run.json"  # what the scenes of a folder are made from
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
        SceneError: `out` holds scenes of another seed, plan or library, or some scenes could
            not be made; the others are there.
    """
    recipe = Recipe(plan, tuple(load_shapes(library)) if library else ())
    out.mkdir(parents=True, exist_ok=True)
    _claim(out, {"seed": seed, "plan": plan, "library": _digest(library)})
    if library is not None and library.resolve() != (out / LIBRARY_FILE).resolve():
        shutil.copyfile(library, out / LIBRARY_FILE)
    sizes = {
        n: min(SCENES_PER_SHARD, scenes - n * SCENES_PER_SHARD)
        for n in range(-(-scenes // SCENES_PER_SHARD))
    }
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


def _claim(out: Path, run: dict) -> None:
    """Notes what the folder's scenes are made from; refuses to mix them with others."""
    path = out / RUN
    if path.exists() and (there := _made_from(path)) != run:
        raise SceneError(f"{out} holds scenes made from {there}; expected {run}")
    path.write_text(json.dumps(run) + "\n")


def _made_from(path: Path) -> dict:
    """What the file that `_claim` wrote says."""
    try:
        there = json.loads(path.read_text())
    except ValueError as error:  # no JSON, or no text at all
        raise SceneError(f"{path} is damaged: {error}; expected what simulate wrote there, e.g. "
                         '{"seed": 7, "plan": "mixed", "library": ""}') from error
    if not isinstance(there, dict):
        raise SceneError(f"{path} holds {there!r}; expected an object with seed, plan and library")
    return there


def _digest(library: Path | None) -> str:
    return sha256(library.read_bytes()).hexdigest()[:16] if library else ""


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
            except Exception as error:  # whatever it was, the rest of the run survives
                _LOG.error("shard %d: %s: %s", number, type(error).__name__, error)
                failed[number] = str(error)
    return done


def _make(out: Path, number: int, size: int, seed: int, recipe: Recipe) -> dict:
    """Makes one shard; a line for the log."""
    begin, skipped = time.time(), Counter[str]()
    first = number * SCENES_PER_SHARD
    scenes = [make_scene(seed, i, recipe, skipped) for i in range(first, first + size)]
    write_shard(shard_path(out, number), scenes, skipped)
    return {"shard": number, "scenes": size, "parts": sum(len(s.poses) for s in scenes),
            "seconds": round(time.time() - begin, 1), "worker": os.getpid(),
            "skipped": dict(skipped)}


def _is_there(path: Path, size: int) -> bool:
    if not path.exists():
        return False
    try:
        return len(read_shard(path)) >= size
    except StackCounterError as error:
        _LOG.error("%s; it is made again", error)
        return False
