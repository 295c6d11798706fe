# SPDX-License-Identifier: Apache-2.0
"""Scenes through the whole reconstruction: recorded with noise, fused, kept with their truth."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter.errors import StackCounterError
from stack_counter.occupancy.maps import stack_maps
from stack_counter.sim import RECONSTRUCTED_KIND, Scene, reconstruct, reconstruct_from_above
from stack_counter.train.data.heights import Sample, read_samples, shape_logs


@dataclass(frozen=True)
class FusedScan:
    """A fused scene: its maps with the truth, and how V came out (m3)."""

    sample: Sample
    true_volume: float
    volume: float
    volume_std: float
    found: bool  # the container, for what it is


def reconstruct_sample(scene: Scene, one_view: bool = False) -> FusedScan | None:
    """One scene, from an arc or from one view; None, with a line on stderr, if it is refused."""
    truth, name = scene.truth, f"{scene.seed}:{scene.index}"
    try:
        volume = reconstruct_from_above(scene) if one_view else reconstruct(scene)
        maps = stack_maps(volume, truth.unit_volume)
    except StackCounterError as error:
        print(f"scene {name}: {error}", file=sys.stderr)
        return None
    of = Sample(maps, truth.gamma, shape_logs(scene), truth.unit_volume ** (1 / 3), name,
                scene.shape.family, scene.container.kind, truth.count, truth.fill)
    return FusedScan(of, truth.stack_volume, volume.stack_volume, volume.stack_volume_std,
                volume.container.kind == RECONSTRUCTED_KIND[scene.container.kind])


def read_scans(folder: Path) -> list[FusedScan]:
    """All scans kept in a folder by `train.scans`."""
    scans = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as file:
            more = file["more"]
        scans += [FusedScan(sample, true, volume, std, bool(found))
                  for sample, (true, volume, std, found) in zip(read_samples(path), more)]
    return scans
