# SPDX-License-Identifier: Apache-2.0
"""Makes many scenes: resumes where it stopped; what lies in a shard depends on the seed alone."""

from __future__ import annotations

import json
import logging
import os
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path

from stack_counter.child_processes import worker_pool
from stack_counter.errors import StackCounterError
from stack_counter.progress import progress_bar
from stack_counter.sim.physics.drop import make_scene
from stack_counter.sim.physics.recipes import Recipe
from stack_counter.sim.scenes.scene import SceneError
from stack_counter.sim.scenes.set_library import (
    RUN_FILE,
    keep_library,
    library_digest,
    read_run_file,
)
from stack_counter.sim.scenes.shards import (
    SCENES_PER_SHARD,
    read_shard,
    shard_path,
    write_shard,
)
from stack_counter.sim.shapes.library import Library, open_library

_LOG = logging.getLogger(__name__)
# File beside the shards with a line of JSON for each.
LOG_FILE = "simulate.log"
# A run gives up after so many pools that lost a worker; chosen.
_MAX_POOLS = 5


@dataclass
class _Run:
    """A run in progress.

    Attributes:
        out: folder of the shards.
        seed, recipe: what the scenes are made from.
        workers: number of processes.
        sizes: number of scenes by shard that are not made yet.
        failed: why a shard cannot be made, by its number.
        advance: takes the number of scenes that have been made.
    """

    out: Path
    seed: int
    recipe: Recipe
    workers: int
    sizes: dict[int, int]
    advance: Callable[[int], object]
    failed: dict[int, str] = field(default_factory=dict)


def simulate(out: Path, scenes: int, workers: int, seed: int, plan: str = "mixed",
             library: Path | None = None) -> None:
    """Makes scenes 0 to `scenes` - 1 that are not there yet; logs to `simulate.log` in `out`.

    Args:
        out: folder of the shards.
        scenes: number of scenes.
        workers: number of processes.
        seed: seed of the run.
        plan: containers and fills, a name in `recipes.PLANS`.
        library: file of the parts to take, which is copied to `out`, or linked if it is a
            collection of others' solids; None for the training families.

    Raises:
        ShapeError: the library is damaged.
        SceneError: `out` holds scenes of another seed, plan or library, or some scenes could
            not be made; the others are there.
    """
    shapes = open_library(library) if library else None
    recipe = Recipe(plan, shapes or ())
    # Note what the scenes are made from, and keep the library beside them
    out.mkdir(parents=True, exist_ok=True)
    _claim_folder(out, {"seed": seed, "plan": plan, **_name_library(shapes)})
    if shapes:
        keep_library(shapes, out)
    # Make the shards that are missing
    shards = range(-(-scenes // SCENES_PER_SHARD))
    sizes = {n: min(SCENES_PER_SHARD, scenes - n * SCENES_PER_SHARD) for n in shards}
    missing = {n: size for n, size in sizes.items() if not _is_whole(shard_path(out, n), size)}
    with progress_bar("simulate", "scenes", scenes, scenes - sum(missing.values())) as advance:
        run = _Run(out, seed, recipe, workers, missing, advance)
        for _ in range(_MAX_POOLS):
            _make_shards(run)
            if set(run.sizes) <= set(run.failed):
                break
            _LOG.error("a worker was killed; %d shards begin again", len(run.sizes))
    if run.sizes:
        why = next(iter(run.failed.values()), "workers were killed too often")
        raise SceneError(f"{len(run.sizes)} of {len(shards)} shards in {out} are missing: {why}")


def _name_library(library: Library | None) -> dict:
    """The library in the note of what scenes are made from: by its content, with its credits."""
    if library is None:
        return {"library": ""}
    credits = {"credits": library.credits} if library.credits else {}
    return {"library": library_digest(library.path), **credits}


def _claim_folder(out: Path, made_from: dict) -> None:
    """Notes what the folder's scenes are made from; refuses to mix them with others."""
    path = out / RUN_FILE
    if path.exists() and (stored := read_run_file(out)) != made_from:
        raise SceneError(f"{out} holds scenes made from {stored}; expected {made_from}")
    path.write_text(json.dumps(made_from) + "\n")


def _make_shards(run: _Run) -> None:
    """Makes shards until all are made or have failed, or a worker is killed.

    Those made go from `run.sizes`.
    """
    remaining = {n: size for n, size in sorted(run.sizes.items()) if n not in run.failed}
    with worker_pool(run.workers) as pool, open(run.out / LOG_FILE, "a", buffering=1) as log:
        jobs: dict[Future, int] = {
            pool.submit(_make_shard, run.out, n, size, run.seed, run.recipe): n
            for n, size in remaining.items()}
        for job in as_completed(jobs):
            number = jobs[job]
            try:
                log.write(json.dumps(job.result()) + "\n")
                run.advance(run.sizes.pop(number))
            except BrokenProcessPool:
                continue
            except Exception as error:  # whatever it was, the rest of the run survives
                _LOG.error("shard %d: %s: %s", number, type(error).__name__, error)
                run.failed[number] = str(error)


def _make_shard(out: Path, number: int, size: int, seed: int, recipe: Recipe) -> dict:
    """Makes one shard and returns its line of the log."""
    start, failed_tries = time.time(), Counter[str]()
    first = number * SCENES_PER_SHARD
    scenes = [make_scene(seed, i, recipe, failed_tries) for i in range(first, first + size)]
    write_shard(shard_path(out, number), scenes, failed_tries)
    return {"shard": number, "scenes": size, "parts": sum(len(s.poses) for s in scenes),
            "seconds": round(time.time() - start, 1), "worker": os.getpid(),
            "skipped": dict(failed_tries)}


def _is_whole(path: Path, size: int) -> bool:
    """A shard is there that can be read and holds as many scenes."""
    if not path.exists():
        return False
    try:
        return len(read_shard(path)) >= size
    except StackCounterError as error:
        _LOG.error("%s; it is made again", error)
        return False
