"""From samples to batches: families in folds, degraded maps, turned and mirrored tiles."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice

import cv2
import numpy as np
import torch

from stack_counter.occupancy.maps import TILE, StackMaps, network_channels
from stack_counter.train.data.degrade import degraded
from stack_counter.train.data.heights import Sample

FOLDS = 5
_AHEAD = 6  # batches prepared while the network learns
_EXACT = 0.5  # share of quarter turns, which leave the pixels as they are
BLIND = 0.08  # share of tiles without walls and floor, as a single view gives them


def group_of(family: str) -> str:
    """Families made alike: a compound part's is how it was begun."""
    return family.split("_")[0]


def fold_of(families: list[str]) -> dict[str, int]:
    """Which fold each family is in: groups of families, never split, dealt at random."""
    groups = sorted({group_of(family) for family in families})
    dealt = np.random.default_rng(5).permutation(len(groups)) % FOLDS
    by_group = dict(zip(groups, dealt.tolist()))
    return {family: by_group[group_of(family)] for family in families}


def tile_of(maps: StackMaps, random: np.random.Generator) -> StackMaps:
    """A tile at a random place, turn and mirroring."""
    rows, cols = maps.valid.shape
    exact = random.random() < _EXACT
    angle = np.pi / 2 * random.integers(4) if exact else random.uniform(0, 2 * np.pi)
    c, s, mirror = np.cos(angle), np.sin(angle), random.choice([-1.0, 1.0])
    turn = np.array([[c, -s], [s, c]]) @ np.diag([mirror, 1.0])
    # A stack larger than the tile is cut at random, a smaller one lies in it with some play.
    size = np.array([cols, rows], float)
    play = np.maximum(np.abs(size - TILE) / 2, 4) * np.where(size > TILE, 0.9, 0.3)
    middle = size / 2 + random.uniform(-1, 1, 2) * play
    shift = TILE / 2 - turn @ middle
    matrix = np.column_stack([turn, np.round(shift) if exact else shift])
    valid = maps.valid.astype(np.float32)
    stacked = np.stack([maps.top * valid, maps.height * valid, maps.wall * valid, valid], axis=-1)
    out = cv2.warpAffine(stacked, matrix, (TILE, TILE), flags=cv2.INTER_LINEAR)
    inside = out[..., 3] > 0.5
    top, height, wall = np.where(inside[..., None], out[..., :3] / np.maximum(
        out[..., 3:], 0.5), 0).astype(np.float32).transpose(2, 0, 1)
    return StackMaps(top, height, inside, wall)


def blinded(x: np.ndarray) -> np.ndarray:
    """Channels as a single view without a known container gives them.

    No wall and no floor, the height being that over the lowest part of the surface.
    """
    valid = x[1] > 0
    if not valid.any():
        return x
    local = x[0] - np.percentile(x[0][valid], 2)
    return np.stack([x[0], x[1], x[1], np.log1p(np.maximum(local, 0) * valid) / 2])


def make_tile(of: Sample, as_is: bool, seed: tuple[int, ...], blind: float = BLIND) -> np.ndarray:
    """(CHANNELS, TILE, TILE) float32 of a sample.

    `as_is`: not degraded, e.g. truly fused; `blind`: how likely it is to be blinded.
    """
    random = np.random.default_rng(seed)
    tile = tile_of(of.maps if as_is else degraded(of, random), random)
    x = network_channels(tile)
    return blinded(x) if random.random() < blind else x


def targets(samples: list[Sample]) -> torch.Tensor:
    """(n, 1 + FORM) float32: log gamma and form."""
    return torch.tensor(np.array([[np.log(s.gamma), *s.form] for s in samples]), dtype=torch.float)


def batches(samples: list[Sample], as_is: list[bool], weights: np.ndarray, size: int, count: int,
            seed: tuple[int, ...], blind: float = BLIND
            ) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """`count` batches of (size, CHANNELS, TILE, TILE) and targets, drawn by weight.

    Prepared in a thread.
    """
    random = np.random.default_rng(seed)
    chosen = random.choice(len(samples), (count, size), p=weights / weights.sum())

    def make(number: int) -> tuple[torch.Tensor, torch.Tensor]:
        rows = chosen[number]
        x = np.stack([make_tile(samples[i], as_is[i], (*seed, number, k), blind)
                      for k, i in enumerate(rows)])
        return torch.from_numpy(x), targets([samples[i] for i in rows])

    with ThreadPoolExecutor(1) as pool:
        numbers = iter(range(count))
        waiting = [pool.submit(make, n) for n in islice(numbers, _AHEAD)]
        while waiting:
            ready = waiting.pop(0).result()
            waiting += [pool.submit(make, n) for n in islice(numbers, 1)]
            yield ready
