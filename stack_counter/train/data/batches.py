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

FOLDS = 5  # groups of families; a member of the ensemble leaves out one
_FOLD_SEED = 5


@dataclass(frozen=True)
class AugmentationSettings:
    """How tiles are drawn; all chosen.

    Attributes:
        blind_share: share of tiles without walls and floor, as a single view gives them.
        quarter_turn_share: share of tiles turned by quarters, which leaves the pixels as they
            are.
        least_play_px: least distance by which a tile's middle is moved at random.
        cut_play: share of the overhang by which the middle moves of stacks larger than a tile.
        padded_play: share of the free space by which it moves of smaller ones.
        batches_ahead: batches prepared while the network learns.
    """

    blind_share: float = 0.08
    quarter_turn_share: float = 0.5
    least_play_px: float = 4
    cut_play: float = 0.9
    padded_play: float = 0.3
    batches_ahead: int = 6


SETTINGS = AugmentationSettings()


def family_group(family: str) -> str:
    """Names the group of families made alike: a compound part's is how it was begun.

    Families of a collection, SOURCE/FAMILY, are never grouped with those of another source.
    """
    source, slash, name = family.rpartition("/")
    return source + slash + name.split("_")[0]


def assign_folds(families: list[str]) -> dict[str, int]:
    """Deals groups of families, which are never split, to folds at random."""
    groups = sorted({family_group(family) for family in families})
    folds = np.random.default_rng(_FOLD_SEED).permutation(len(groups)) % FOLDS
    by_group = dict(zip(groups, folds.tolist()))
    return {family: by_group[family_group(family)] for family in families}


def draw_tile(maps: StackMaps, random: np.random.Generator) -> StackMaps:
    """Cuts a tile at a random place, turn and mirroring."""
    rows, cols = maps.valid.shape
    # Draw the turn and the mirroring.
    exact = random.random() < SETTINGS.quarter_turn_share
    angle = np.pi / 2 * random.integers(4) if exact else random.uniform(0, 2 * np.pi)
    c, s, mirror = np.cos(angle), np.sin(angle), random.choice([-1.0, 1.0])
    turn = np.array([[c, -s], [s, c]]) @ np.diag([mirror, 1.0])
    # Draw the middle: a stack larger than the tile is cut, a smaller one lies in it with play.
    size = np.array([cols, rows], float)
    play = np.maximum(np.abs(size - TILE) / 2, SETTINGS.least_play_px) * np.where(
        size > TILE, SETTINGS.cut_play, SETTINGS.padded_play)
    middle = size / 2 + random.uniform(-1, 1, 2) * play
    shift = TILE / 2 - turn @ middle
    # Warp the maps; near the border divide by what is valid.
    matrix = np.column_stack([turn, np.round(shift) if exact else shift])
    valid = maps.valid.astype(np.float32)
    stacked = np.stack([maps.top * valid, maps.height * valid, maps.wall * valid, valid], axis=-1)
    warped = cv2.warpAffine(stacked, matrix, (TILE, TILE), flags=cv2.INTER_LINEAR)
    inside = warped[..., 3] > 0.5
    top, height, wall = np.where(inside[..., None], warped[..., :3] / np.maximum(
        warped[..., 3:], 0.5), 0).astype(np.float32).transpose(2, 0, 1)
    return StackMaps(top, height, inside, wall)


def hide_container(x: np.ndarray) -> np.ndarray:
    """Takes walls and floor out of network inputs, as a single view does not know them.

    Args:
        x: (CHANNELS, rows, cols) of `network_channels`.

    Returns:
        The same with heights over the lowest part of the surface.
    """
    valid = x[1] > 0
    if not valid.any():
        return x
    local = x[0] - np.percentile(x[0][valid], 2)
    return np.stack([x[0], x[1], x[1], np.log1p(np.maximum(local, 0) * valid) / 2])


def make_input(sample: Sample, as_is: bool, seed: tuple[int, ...],
               blind_share: float = SETTINGS.blind_share) -> np.ndarray:
    """Makes one network input of a sample.

    Args:
        sample: a scene's maps.
        as_is: they are not degraded, as those that were truly fused.
        seed: of all that is drawn.
        blind_share: probability of being blinded.

    Returns:
        (CHANNELS, TILE, TILE) float32.
    """
    random = np.random.default_rng(seed)
    tile = draw_tile(sample.maps if as_is else degrade_like_fusion(sample, random), random)
    x = network_channels(tile)
    return hide_container(x) if random.random() < blind_share else x


def target_tensor(samples: list[Sample]) -> torch.Tensor:
    """(n, 1 + SHAPE_OUTPUTS) float32: log gamma and shape."""
    return torch.tensor(np.array([[np.log(s.gamma), *s.shape_logs] for s in samples]),
                        dtype=torch.float)


def draw_batches(samples: list[Sample], as_is: list[bool], weights: np.ndarray, size: int,
                 count: int, seed: tuple[int, ...], blind_share: float = SETTINGS.blind_share
                 ) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Yields batches of inputs (size, CHANNELS, TILE, TILE) and targets, prepared in a thread.

    Args:
        samples: what is drawn from.
        as_is: for each sample whether it is not degraded.
        weights: (n,) how often each is drawn, relatively.
        size: samples of a batch.
        count: number of batches.
        seed: of all that is drawn.
        blind_share: probability of a tile without walls and floor.
    """
    random = np.random.default_rng(seed)
    chosen = random.choice(len(samples), (count, size), p=weights / weights.sum())

    def make_batch(number: int) -> tuple[torch.Tensor, torch.Tensor]:
        rows = chosen[number]
        x = np.stack([make_input(samples[i], as_is[i], (*seed, number, k), blind_share)
                      for k, i in enumerate(rows)])
        return torch.from_numpy(x), target_tensor([samples[i] for i in rows])

    with ThreadPoolExecutor(1) as pool:
        numbers = iter(range(count))
        waiting = [pool.submit(make_batch, n) for n in islice(numbers, SETTINGS.batches_ahead)]
        while waiting:
            ready = waiting.pop(0).result()
            waiting += [pool.submit(make_batch, n) for n in islice(numbers, 1)]
            yield ready
