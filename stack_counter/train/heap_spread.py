# SPDX-License-Identifier: Apache-2.0
"""How gamma of heaps differs from that of the same part in open containers.

It measures `heap` of `parts.scan_spread` on true surfaces of training scenes, some of one part in
a row, and how much a surface's gaps hold that a film would bridge.

    python -m stack_counter.train.heap_spread data/train-deep --scenes 1200
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from scipy import ndimage

from stack_counter.occupancy.maps import PIXELS_PER_LENGTH
from stack_counter.parts.gamma_model import fill_features
from stack_counter.sim import Scene, ideal_surface, read_scenes

_DEEP = 1.5  # part lengths of mean height from which on a pile's bridged gaps are averaged


@dataclass(frozen=True)
class PileFigures:
    """A pile's gamma and what it depends on.

    Attributes:
        part: family and seed of its part.
        is_heap: it lies in no container.
        log_gamma: log of its true gamma.
        features: of its fill, its friction, and whether it was shaken.
        height: mean height of the fill, part lengths.
        bridged: mean depth of the gaps that a ball of a part length bridges, part lengths.
    """

    part: tuple[str, int]
    is_heap: bool
    log_gamma: float
    features: tuple[float, ...]
    height: float
    bridged: float


def measure_pile(scene: Scene) -> PileFigures:
    """Measures a scene that holds parts."""
    surface = ideal_surface(scene)
    fill = np.where(surface.valid, surface.top - surface.inner, 0)
    area = np.count_nonzero(surface.valid) / PIXELS_PER_LENGTH**2
    height = float(fill.sum()) / PIXELS_PER_LENGTH**2 / area
    x = fill_features(np.array([height]), np.array([np.sqrt(area)]))[0, 1:]
    # Close the gaps as a ball does that rolls over the surface.
    axis = np.arange(-PIXELS_PER_LENGTH, PIXELS_PER_LENGTH + 1)
    disk = np.hypot(*np.meshgrid(axis, axis)) <= PIXELS_PER_LENGTH
    top = np.where(surface.valid, surface.top, 0)
    bridged = (ndimage.grey_closing(top, footprint=disk) - top)[surface.valid].mean()
    shape, is_heap = scene.shape, scene.container.kind == "none"
    return PileFigures((shape.family, shape.seed), is_heap, float(np.log(scene.truth.gamma)),
                       (*x, scene.friction, float(scene.taps > 0)), height, float(bridged))


def heap_differences(piles: Sequence[PileFigures]) -> tuple[np.ndarray, float]:
    """Log gamma of heaps less that of their part's piles, and the deviation of one pile.

    Both at the same fill and friction, by a regression within parts.
    """
    parts = [list(group) for _, group in groupby(piles, lambda pile: pile.part)]
    walled = [[p for p in part if not p.is_heap] for part in parts]
    # Fit the slopes to piles in containers, each about the mean of its part's.
    several = [part for part in walled if len(part) > 1]
    x, y = (np.concatenate([np.array(v) - np.mean(v, axis=0) for v in values]) for values in (
        [[p.features for p in part] for part in several],
        [[p.log_gamma for p in part] for part in several]))
    slopes = np.linalg.lstsq(x, y, rcond=None)[0]
    deviation = np.sqrt(np.sum((y - x @ slopes) ** 2) / (len(y) - len(several)))

    def level(pile: PileFigures) -> float:
        return pile.log_gamma - float(np.dot(pile.features, slopes))

    return np.array([level(pile) - np.mean([level(p) for p in others])
                     for part, others in zip(parts, walled) if others
                     for pile in part if pile.is_heap]), float(deviation)


def main(argv: Sequence[str] | None = None) -> int:
    """Measures a set and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of scenes, some of one part in a row")
    parser.add_argument("--scenes", type=int, help="number of scenes; all by default")
    args = parser.parse_args(argv)
    piles = [measure_pile(s) for s in read_scenes(args.data, args.scenes) if s.truth.count]
    differences, deviation = heap_differences(piles)
    bridged = [p.bridged / p.height for p in piles if p.height > _DEEP]
    print(f"{len(differences)} heaps: log gamma {differences.mean():+.3f}, deviation "
          f"{differences.std():.3f}; of one pile in a container {deviation:.3f}; bridged gaps of "
          f"deep piles {np.mean(bridged):.2f} of V")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
