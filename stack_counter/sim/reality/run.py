# SPDX-License-Identifier: Apache-2.0
"""Many piles of many experiments, shared among processes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import as_completed

from stack_counter.child_processes import worker_pool
from stack_counter.errors import StackCounterError
from stack_counter.progress import progress_bar
from stack_counter.sim.reality.experiments import EXPERIMENTS
from stack_counter.sim.reality.piles import Pile, simulate_experiment
from stack_counter.sim.reality.table import Row


def run_experiments(chosen: Sequence[int], seeds: int, workers: int) -> list[Row]:
    """Simulates so many piles of each of the `EXPERIMENTS`; prints each row when it is whole.

    What cannot be simulated is said on stderr and has no row.
    """
    piles: dict[int, list[Pile]] = {i: [] for i in chosen}
    rows: dict[int, Row] = {}
    with worker_pool(workers) as pool, \
            progress_bar("reality", "piles", len(chosen) * seeds) as advance:
        jobs = {pool.submit(_run_job, i, seed): i for i in chosen for seed in range(seeds)}
        for job in as_completed(jobs):
            i = jobs[job]
            advance()
            try:
                piles[i].append(job.result())
            except StackCounterError as error:
                print(error, file=sys.stderr)
                continue
            if len(piles[i]) == seeds:
                experiment = EXPERIMENTS[i]
                rows[i] = Row(experiment, experiment.measured_share(experiment.part()), piles[i])
                print(" | ".join(rows[i].cells()), flush=True)
    return [rows[i] for i in sorted(rows)]


def _run_job(index: int, seed: int) -> Pile:
    """One pile, in a process of the pool."""
    return simulate_experiment(EXPERIMENTS[index], seed)
