# SPDX-License-Identifier: Apache-2.0
"""Makes many scenes: resumes where it stopped; what lies in a shard depends on the seed alone."""

from __future__ import annotations

import json
import logging
import os
import time
from collections import Counter
from functools import partial
from pathlib import Path

from stack_counter.errors import StackCounterError
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
from stack_counter.tasks.progress import progress_bar
from stack_counter.tasks.workers import Workers, run_tasks

_LOG = logging.getLogger(__name__)
# File beside the shards with a line of JSON for each.
LOG_FILE = "simulate.log"


def simulate(out: Path, scenes: int, workers: Workers, seed: int, plan: str = "mixed",
             library: Path | None = None) -> None:
    """Makes scenes 0 to `scenes` - 1 that are not there yet; logs to `simulate.log` in `out`.

    Args:
        out: folder of the shards, the same for every worker.
        scenes: number of scenes.
        workers: where.
        seed: seed of the run.
        plan: containers and fills, a name in `recipes.PLANS`.
        library: file of the parts to take, which is copied to `out`, or linked if it is a
            collection of others' solids; None for the training families.

    Raises:
        ShapeError: the library is damaged.
        SceneError: `out` holds scenes of another seed, plan or library, or some scenes could
            not be made; the others are there.
        ConfigError: the Ray cluster cannot be reached, or Ray is not installed.
    """
    shapes = open_library(library) if library else None
    recipe = Recipe(plan, shapes or ())
    # Note what the scenes are made from, and keep the library beside them
    out.mkdir(parents=True, exist_ok=True)
    _claim_folder(out, {"seed": seed, "plan": plan, **_name_library(shapes)})
    if shapes:
        keep_library(shapes, out)
    # Make the shards that are missing
    shards = {first // SCENES_PER_SHARD: range(first, min(first + SCENES_PER_SHARD, scenes))
              for first in range(0, scenes, SCENES_PER_SHARD)}
    missing = {number: indices for number, indices in shards.items()
               if not _is_whole(shard_path(out, number), len(indices))}
    failed: list[str] = []
    done = scenes - sum(map(len, missing.values()))
    with progress_bar("simulate", "scenes", scenes, done) as advance, \
            open(out / LOG_FILE, "a", buffering=1) as log:
        make = partial(_make_shard, out.absolute(), seed, recipe)
        for (number, indices), shard in run_tasks(make, missing.items(), workers):
            try:
                log.write(json.dumps(shard.result()) + "\n")
                advance(len(indices))
            except Exception as error:  # whatever it was, the rest of the run survives
                _LOG.error("shard %d: %s: %s", number, type(error).__name__, error)
                failed.append(str(error))
    if failed:
        raise SceneError(f"{len(failed)} of {len(shards)} shards in {out} are missing: "
                         f"{failed[0]}")


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


def _make_shard(out: Path, seed: int, recipe: Recipe, task: tuple[int, range]) -> dict:
    """Makes one shard, given its number and scenes, and returns its line of the log."""
    number, indices = task
    start, failed_tries = time.time(), Counter[str]()
    scenes = [make_scene(seed, i, recipe, failed_tries) for i in indices]
    write_shard(shard_path(out, number), scenes, failed_tries)
    return {"shard": number, "scenes": len(indices), "parts": sum(len(s.poses) for s in scenes),
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
