# SPDX-License-Identifier: Apache-2.0
"""Scenes through the whole reconstruction: recorded with noise, fused, stored with their truth."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stack_counter.errors import StackCounterError
from stack_counter.occupancy.maps import stack_maps
from stack_counter.sim import RECONSTRUCTED_KIND, Scene, reconstruct
from stack_counter.train.data.heights import Sample, label_maps, read_samples
from stack_counter.types import Reason, StackVolume

Reconstruct = Callable[[Scene], StackVolume]


@dataclass(frozen=True, eq=False)
class FusedScan:
    """A fused scene.

    Attributes:
        sample: its maps with the truth.
        true_volume: V as an ideal view from above has it, m3.
        volume: V as measured, m3.
        volume_std: its standard deviation, m3.
        found: the container was found for what it is.
    """

    sample: Sample
    true_volume: float
    volume: float
    volume_std: float
    found: bool


def reconstruct_sample(scene: Scene, how: Reconstruct = reconstruct) -> FusedScan | None:
    """Records and reconstructs a scene.

    Args:
        scene: what is recorded.
        how: records and reconstructs it.

    Returns:
        None, with a line on stderr, if the scan is refused.
    """
    try:
        volume = how(scene)
        maps = stack_maps(volume, scene.truth.unit_volume)
    except StackCounterError as error:
        print(f"scene {scene.seed}:{scene.index}: {error}", file=sys.stderr)
        return None
    sample = replace(label_maps(maps, scene), resolution_m=volume.resolution_m,
                     from_pictures=Reason.DEPTH_FROM_PICTURES in volume.reasons)
    return FusedScan(sample, scene.truth.stack_volume, volume.stack_volume,
                     volume.stack_volume_std,
                     volume.container.kind == RECONSTRUCTED_KIND[scene.container.kind])


def read_scans(folder: Path) -> list[FusedScan]:
    """Reads all scans that `train.scans` has stored in a folder."""
    scans = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as file:
            more = file["more"]
        scans += [FusedScan(sample, true_volume, volume, std, bool(found)) for
                  sample, (true_volume, volume, std, found) in zip(read_samples(path), more)]
    return scans
