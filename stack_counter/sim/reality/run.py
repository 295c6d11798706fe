# SPDX-License-Identifier: Apache-2.0
"""Many piles of many experiments, shared among processes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import as_completed

from stack_counter.errors import StackCounterError
from stack_counter.sim.reality import nesting, part_piles
from stack_counter.sim.reality.experiments import EXPERIMENTS, Experiment
from stack_counter.sim.reality.piles import Pile, friction_of, simulate_experiment
from stack_counter.sim.reality.table import Row
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.tasks.progress import progress_bar


def run_experiments(chosen: Sequence[int], seeds: int, workers: int,
                    friction: float | None = None) -> list[Row]:
    """Simulates so many piles of each of the `EXPERIMENTS`; prints each row when it is whole.

    What cannot be simulated is said on stderr and has no row. With a friction all are poured with
    that one.
    """
    rows = {i: _empty_row(EXPERIMENTS[i], friction) for i in chosen}
    with worker_pool(workers) as pool, \
            progress_bar("reality", "piles", len(chosen) * seeds) as advance:
        jobs = {pool.submit(_run_job, i, seed, row.friction): row
                for i, row in rows.items() for seed in range(seeds)}
        for job in as_completed(jobs):
            row = jobs[job]
            advance()
            try:
                row.piles.append(job.result())
            except StackCounterError as error:
                print(error, file=sys.stderr)
            else:
                if len(row.piles) == seeds:
                    print(" | ".join(row.cells()), flush=True)
    return [row for row in rows.values() if row.piles]


def _empty_row(experiment: Experiment, friction: float | None) -> Row:
    """A row without piles; without a friction it has that of the experiment's pour."""
    return Row(experiment, experiment.measured_share(experiment.part()),
               friction_of(experiment.pour) if friction is None else friction, [])


def _run_job(index: int, seed: int, friction: float) -> Pile:
    """One pile, in a process of the pool."""
    return simulate_experiment(EXPERIMENTS[index], seed, friction)


def run_comparisons(workers: int) -> list[str]:
    """Hulls against decompositions, and piles as `part add` draws them; prints each sentence.

    What cannot be simulated is said on stderr and left out.
    """
    sentences = []
    with worker_pool(workers) as pool:
        jobs = [pool.submit(nesting.describe_nesting, family) for family in nesting.SETTINGS.parts]
        jobs += [pool.submit(part_piles.describe_part_piles, name)
                 for name in part_piles.SETTINGS.names]
        for job in jobs:
            try:
                sentences.append(job.result())
                print(sentences[-1], flush=True)
            except StackCounterError as error:
                print(error, file=sys.stderr)
    return sentences
