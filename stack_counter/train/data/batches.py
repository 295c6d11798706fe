# SPDX-License-Identifier: Apache-2.0
"""From samples to batches: families in folds, degraded maps, turned and mirrored tiles."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
import torch

from stack_counter.occupancy.maps import TILE, StackMaps, network_channels
from stack_counter.train.data.degrade import degrade_like_fusion
from stack_counter.train.data.heights import Sample

FOLDS = 5
# Share of tiles without walls and floor, as a single view gives them.
BLIND = 0.08

@dataclass(frozen=True)
class BatchSettings:
    """How tiles are drawn; chosen.

    Attributes:
        prepared: batches that are prepared while the network learns.
        exact_turns: share of tiles with quarter turns, which leave the pixels as they are.
    """

    prepared: int = 6
    exact_turns: float = 0.5


SETTINGS = BatchSettings()


def family_group(family: str) -> str:
    """Returns the group of a family: compound parts that begin alike are one group."""
    return family.split("_")[0]


def assign_folds(families: list[str]) -> dict[str, int]:
    """Assigns each family to a fold at random; groups of families are never split."""
    groups = sorted({family_group(family) for family in families})
    dealt = np.random.default_rng(5).permutation(len(groups)) % FOLDS
    by_group = dict(zip(groups, dealt.tolist()))
    return {family: by_group[family_group(family)] for family in families}


def draw_tile(maps: StackMaps, random: np.random.Generator) -> StackMaps:
    """Draws a tile at a random place, turn and mirroring."""
    rows, cols = maps.valid.shape
    exact = random.random() < SETTINGS.exact_turns
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


def hide_container(x: np.ndarray) -> np.ndarray:
    """Returns the channels that a single view without a known container gives.

    No wall and no floor, the height being that over the lowest part of the surface.
    """
    valid = x[1] > 0
    if not valid.any():
        return x
    local = x[0] - np.percentile(x[0][valid], 2)
    return np.stack([x[0], x[1], x[1], np.log1p(np.maximum(local, 0) * valid) / 2])


def make_input(
    sample: Sample, as_is: bool, seed: tuple[int, ...], blind: float = BLIND
) -> np.ndarray:
    """Makes the (CHANNELS, TILE, TILE) float32 input of a sample.

    Args:
        sample: maps and truth.
        as_is: the maps are not degraded, as they were truly fused.
        seed: of the random draws.
        blind: probability that wall and floor are hidden.
    """
    random = np.random.default_rng(seed)
    tile = draw_tile(sample.maps if as_is else degrade_like_fusion(sample, random), random)
    x = network_channels(tile)
    return hide_container(x) if random.random() < blind else x


def target_tensor(samples: list[Sample]) -> torch.Tensor:
    """Returns (n, 1 + SHAPE_OUTPUTS) float32: log gamma and the logs of the shape."""
    values = np.array([[np.log(s.gamma), *s.shape_logs] for s in samples])
    return torch.tensor(values, dtype=torch.float)


def draw_batches(
    samples: list[Sample],
    as_is: list[bool],
    weights: np.ndarray,
    size: int,
    count: int,
    seed: tuple[int, ...],
    blind: float = BLIND,
) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """`count` batches of (size, CHANNELS, TILE, TILE) and targets, drawn by weight.

    Prepared in a thread.
    """
    random = np.random.default_rng(seed)
    chosen = random.choice(len(samples), (count, size), p=weights / weights.sum())

    def make(number: int) -> tuple[torch.Tensor, torch.Tensor]:
        rows = chosen[number]
        x = np.stack([make_input(samples[i], as_is[i], (*seed, number, k), blind)
                      for k, i in enumerate(rows)])
        return torch.from_numpy(x), target_tensor([samples[i] for i in rows])

    with ThreadPoolExecutor(1) as pool:
        numbers = iter(range(count))
        waiting = [pool.submit(make, n) for n in islice(numbers, SETTINGS.prepared)]
        while waiting:
            ready = waiting.pop(0).result()
            waiting += [pool.submit(make, n) for n in islice(numbers, 1)]
            yield ready
