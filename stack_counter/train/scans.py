# SPDX-License-Identifier: Apache-2.0
"""Recordings of training scenes through the whole reconstruction.

What the network is fitted to and its errors are measured on, as at run time.

    python -m stack_counter.train.scans OUT data/train-deep:6 data/train-shallow:27 --workers 2
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter.sim import (
    read_shard,
    reconstruct,
    reconstruct_from_above,
    reconstruct_from_pictures,
)
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.tasks.progress import progress
from stack_counter.train.data.fused import Reconstruct, reconstruct_sample
from stack_counter.train.data.heights import write_samples

# How a scene is seen.
HOW: dict[str, Reconstruct] = {"arc": reconstruct, "one view": reconstruct_from_above,
                               "pictures": reconstruct_from_pictures}


@dataclass(frozen=True)
class _Job:
    """A shard whose every `step`-th scene is reconstructed into the file `out`, see `HOW`."""

    shard: Path
    step: int
    out: Path
    how: str


def _store_scans(job: _Job) -> None:
    """Reconstructs scenes of a shard and writes those that are not refused."""
    scenes = [s for s in read_shard(job.shard) if s.truth.count and s.index % job.step == 0]
    scans = [scan for scene in scenes if (scan := reconstruct_sample(scene, HOW[job.how]))]
    if scans:
        write_samples(job.out, [s.sample for s in scans], more=np.array(
            [(s.true_volume, s.volume, s.volume_std, s.found) for s in scans]))


def main() -> int:
    """Reconstructs every `step`-th scene of each folder; resumes where it stopped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="+", metavar="DIR:STEP")
    parser.add_argument("--workers", type=int, default=1)
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--one-view", action="store_const", const="one view", dest="how",
                     help="of a fixed camera above, not an arc of views")
    how.add_argument("--pictures", action="store_const", const="pictures", dest="how",
                     help="24 pictures with labels, without depth: half a minute a scene")
    parser.set_defaults(how="arc")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    jobs = []
    for text in options.scenes:
        folder, _, step = text.rpartition(":")
        jobs += [_Job(path, int(step), options.out / f"{Path(folder).name}_{path.stem}.npz",
                      options.how)
                 for path in sorted(Path(folder).glob("shard_*.npz"))]
    jobs = [job for job in jobs if not job.out.exists()]
    with worker_pool(options.workers) as pool:
        for _ in progress(pool.map(_store_scans, jobs), "scans", "shards", len(jobs)):
            pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
