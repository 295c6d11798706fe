# SPDX-License-Identifier: Apache-2.0
"""Fits the paper's baselines (section 4.3) on simulated piles, fused as at run time.

    python -m stack_counter.train.baselines data/train OUT.safetensors --shards 6 --workers 2

Every scene is recorded with depth and pose noise and reconstructed by `StackCounter`, so that the
line is fitted on the maps that it will read. Residuals are those of families left out.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import StackCounterError
from stack_counter.files import write_weights
from stack_counter.occupancy.baselines import FORMAT, SETTINGS, normalized_height
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, read_shard, record
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.tasks.progress import progress

_QUANTILES = 101
# Kinds of containers that are learnt from, and what the reconstruction calls them.
_FOUND_AS = {"bin": "box", "tray": "box", "none": "none"}


@dataclass(frozen=True)
class Row:
    """One scene, true and reconstructed; lengths in metres, volumes in m3.

    Attributes:
        scene: `seed:index`.
        family: of the part's shape.
        kind: of the container, as the simulator names it.
        found: of the container, as the reconstruction names it.
        count: true number of parts.
        part_size: largest side of the part.
        unit_volume: v.
        gamma: true occupancy ratio.
        true_volume: V as an ideal view from above has it.
        volume: V as measured.
        volume_std: its standard deviation.
        coverage: share of the footprint that was seen.
        height: normalised height, see `normalized_height`.
    """

    scene: str
    family: str
    kind: str
    found: str
    count: int
    part_size: float
    unit_volume: float
    gamma: float
    true_volume: float
    volume: float
    volume_std: float
    coverage: float
    height: float


def measure_shard(path: Path) -> list[Row]:
    """Measures a shard's scenes in containers that the reconstruction knows."""
    return [row for scene in read_shard(path) if scene.container.kind in _FOUND_AS
            if (row := measure_scene(scene))]


def measure_scene(scene: Scene, views: int = 12) -> Row | None:
    """Records and reconstructs one scene; None, with a line on stderr, if that fails."""
    truth, name = scene.truth, f"{scene.seed}:{scene.index}"
    try:
        stack = StackCounter(ReconstructorConfig())
        for view in record(scene, views, seed=scene.index, color=False):
            stack.add_view(view)
        volume = stack.volume()
    except StackCounterError as error:
        print(f"scene {name}: {error}", file=sys.stderr)
        return None
    height = normalized_height(volume)
    if height is None:
        return None
    return Row(name, scene.shape.family, scene.container.kind, volume.container.kind,
               truth.count, scene.shape.part_size, truth.unit_volume, truth.gamma,
               truth.stack_volume, volume.stack_volume, volume.stack_volume_std, volume.coverage,
               height)


def summarize_volume_errors(rows: list[Row]) -> dict[str, str]:
    """Puts V's relative errors into words, by kind of container.

    Mean absolute error, mean and 95th percentile, where the container was found for what it is.
    """
    lines = {}
    for kind in sorted({row.kind for row in rows}):
        found = [r for r in rows if r.kind == kind and r.found == _FOUND_AS[kind]]
        errors = np.array([r.volume / r.true_volume - 1 for r in found])
        scenes = sum(r.kind == kind for r in rows)
        lines[f"volume_{kind}"] = (
            f"{len(errors)} of {scenes} found, mean abs {np.abs(errors).mean():.3f}, bias "
            f"{errors.mean():+.3f}, p95 {np.quantile(abs(errors), 0.95):.3f}")
    return lines


def fit_baselines(rows: list[Row]) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Fits the tensors of the weights file, and measures the errors on families left out."""
    gamma, height = (np.array([getattr(r, n) for r in rows]) for n in ("gamma", "height"))
    family = np.array([r.family for r in rows])
    # Estimate each family by a fit to the others.
    corrected, means = np.empty(len(rows)), np.empty(len(rows))
    for name in np.unique(family):
        own = family == name
        corrected[own] = np.polyval(np.polyfit(height[~own], gamma[~own], 1), height[own])
        means[own] = gamma[~own].mean()
    estimates = {"corrected": np.clip(corrected, *SETTINGS.gamma_range), "extrapolated": height,
                 "prior": means}
    # Quantiles of their ratios give the interval.
    shares = np.linspace(0, 1, _QUANTILES)
    tensors = {"line": np.polyfit(height, gamma, 1),
               "prior": np.array([gamma.mean(), gamma.std()]),
               **{f"ratios_{name}": np.quantile(gamma / estimate, shares)
                  for name, estimate in estimates.items()}}
    # Errors.
    spread = ((gamma - gamma.mean()) ** 2).sum()
    errors = {}
    for name, estimate in estimates.items():
        errors[f"{name}_mae"] = float(np.abs(gamma - estimate).mean())
        errors[f"{name}_r2"] = float(1 - ((gamma - estimate) ** 2).sum() / spread)
    return {name: np.asarray(t, np.float64) for name, t in tensors.items()}, errors


def main() -> int:
    """Measures all scenes of a folder and writes the weights and the rows beside them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, help="folder of shards")
    parser.add_argument("out", type=Path)
    parser.add_argument("--shards", type=int, default=6, help="how many of them to read")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    paths = sorted(options.scenes.glob("shard_*.npz"))[:options.shards]
    with worker_pool(options.workers) as pool:
        rows = [row for shard in progress(pool.map(measure_shard, paths), "volumes", "shards",
                                          len(paths)) for row in shard]
    options.out.with_suffix(".jsonl").write_text(
        "".join(json.dumps(asdict(row)) + "\n" for row in rows))
    found = [row for row in rows if row.found == _FOUND_AS[row.kind]]
    tensors, errors = fit_baselines(found)
    facts = {"scenes": str(len(found)), **{k: f"{v:.4f}" for k, v in errors.items()}}
    write_weights(options.out, FORMAT, tensors, facts)
    print(json.dumps({**facts, **summarize_volume_errors(rows)}, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
