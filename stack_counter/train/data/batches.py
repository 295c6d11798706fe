# SPDX-License-Identifier: Apache-2.0
"""From samples to batches: families in folds, degraded maps, turned and mirrored tiles."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset
from typing_extensions import override

from stack_counter.fusion.tsdf import voxel_size_for
from stack_counter.occupancy.known_form import add_size_errors, hide_above
from stack_counter.occupancy.maps import TILE, StackMaps, network_channels
from stack_counter.occupancy.resolution import resolution_values
from stack_counter.sim import source_of
from stack_counter.train.data.degrade import degrade_like_fusion
from stack_counter.train.data.heights import Sample
from stack_counter.train.data.stereo_surface import degrade_like_stereo, draw_resolution
from stack_counter.types import KnownLevel

FOLDS = 5  # groups of families; a member of the ensemble leaves out one
_FOLD_SEED = 5
_KNOWN_SEED = 0xF0
_PICTURES_SEED = 0x57E


@dataclass(frozen=True)
class AugmentationSettings:
    """How tiles are drawn; all chosen.

    Attributes:
        blind_share: share of tiles without walls and floor, as a single view gives them.
        picture_share: share of the cast surfaces that are degraded as stereo on pictures does.
        quarter_turn_share: share of tiles turned by quarters, which leaves the pixels as they
            are.
        least_play_px: least distance by which a tile's middle is moved at random.
        cut_play: share of the overhang by which the middle moves of stacks larger than a tile.
        padded_play: share of the free space by which it moves of smaller ones.
        batches_ahead: batches prepared while the network learns.
        known_shares: share of the tiles of which v alone is known, of those of which the outer
            dimensions are too, and of those with a mesh.
        size_error: standard deviation of the relative error of outer dimensions.
    """

    blind_share: float = 0.08
    picture_share: float = 0.25
    quarter_turn_share: float = 0.5
    least_play_px: float = 4
    cut_play: float = 0.9
    padded_play: float = 0.3
    batches_ahead: int = 6
    known_shares: tuple[float, float, float] = (0.4, 0.3, 0.3)
    size_error: float = 0.02


SETTINGS = AugmentationSettings()


class Batch(NamedTuple):
    """Tiles to learn from.

    Attributes:
        x: (b, CHANNELS, TILE, TILE) inputs.
        known: (b, KNOWN_VALUES) what is known of the parts' form.
        resolution: (b, RESOLUTION_VALUES) how finely the surfaces were measured.
        y: (b, 1 + SHAPE_OUTPUTS) targets of `target_tensor`.
    """

    x: torch.Tensor
    known: torch.Tensor
    resolution: torch.Tensor
    y: torch.Tensor


def family_group(family: str) -> str:
    """Names the group of families made alike: a compound part's is how it was begun.

    Families of a collection, SOURCE/FAMILY, are never grouped with those of another source.
    """
    source, slash, name = family.rpartition("/")
    return source + slash + name.split("_")[0]


def assign_folds(families: list[str]) -> dict[str, int]:
    """Deals groups of families, which are never split, to folds at random.

    Each source's are dealt apart, beginning at a fold of its own: every fold has its share of
    them, and a further source moves none of the families of the others.
    """
    by_group: dict[str, int] = {}
    for source in sorted({source_of(family) for family in families}):
        groups = sorted({family_group(f) for f in families if source_of(f) == source})
        dealt = np.random.default_rng(_FOLD_SEED).permutation(len(groups))
        folds = (dealt + zlib.crc32(source.encode())) % FOLDS
        by_group |= dict(zip(groups, folds.tolist()))
    return {family: by_group[family_group(family)] for family in families}


def draw_tile(maps: StackMaps, random: np.random.Generator) -> StackMaps:
    """Cuts a tile at a random place, turn and mirroring."""
    return warp_maps(maps, draw_tile_place(maps.valid.shape, random))


def draw_tile_place(shape: tuple[int, ...], random: np.random.Generator) -> np.ndarray:
    """(2, 3) float64 from x and y in maps of `shape` to those in a tile: turned, or mirrored."""
    rows, cols = shape
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
    return np.column_stack([turn, np.round(shift) if exact else shift])


def warp_maps(maps: StackMaps, place: np.ndarray) -> StackMaps:
    """Cuts the tile that a (2, 3) `place` of `draw_tile_place` says."""
    # Near the border divide by what is valid.
    valid = maps.valid.astype(np.float32)
    stacked = np.stack([maps.top * valid, maps.height * valid, maps.wall * valid, valid], axis=-1)
    warped = cv2.warpAffine(stacked, place, (TILE, TILE), flags=cv2.INTER_LINEAR)
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


class NetworkInput(NamedTuple):
    """What a network reads of a tile, besides the part's form.

    Attributes:
        x: (CHANNELS, TILE, TILE) float32 of `maps.network_channels`.
        resolution: (RESOLUTION_VALUES,) float32 of `resolution.resolution_values`.
    """

    x: np.ndarray
    resolution: np.ndarray


def make_input(sample: Sample, as_is: bool, seed: tuple[int, ...],
               blind_share: float = SETTINGS.blind_share,
               picture_share: float = SETTINGS.picture_share) -> NetworkInput:
    """Makes one network input of a sample.

    Args:
        sample: a scene's maps.
        as_is: they are not degraded, as those that were truly fused.
        seed: of all that is drawn.
        blind_share: probability of being blinded.
        picture_share: probability of being degraded as stereo on pictures does, if it was cast.
    """
    random = np.random.default_rng(seed)
    of_pictures = np.random.default_rng((*seed, _PICTURES_SEED))
    from_pictures = not as_is and sample.seen_by is not None \
        and of_pictures.random() < picture_share
    # Degrade the surface as one of the two does, or not.
    if from_pictures:
        drawn = draw_resolution(sample.part_length_m, of_pictures)
        resolution, maps = (resolution_values(drawn, from_pictures=True),
                            degrade_like_stereo(sample, drawn, of_pictures))
    else:
        resolution, maps = (fused_resolution(sample),
                            sample.maps if as_is else degrade_like_fusion(sample, random))
    x = network_channels(draw_tile(maps, random))
    return NetworkInput(hide_container(x) if random.random() < blind_share else x, resolution)


def fused_resolution(sample: Sample) -> np.ndarray:
    """(RESOLUTION_VALUES,) of a sample's surface; of a cast one as views with depth are fused."""
    length = sample.resolution_m or voxel_size_for(sample.part_length_m**3)
    return resolution_values(length / sample.part_length_m, sample.from_pictures)


def target_tensor(samples: list[Sample]) -> torch.Tensor:
    """(n, 1 + SHAPE_OUTPUTS) float32: log gamma and shape."""
    return torch.tensor(np.array([[np.log(s.gamma), *s.shape_logs] for s in samples]),
                        dtype=torch.float)


def draw_known(sample: Sample, seed: tuple[int, ...]) -> np.ndarray:
    """(KNOWN_VALUES,) what is known of a sample's form, hidden down to a level drawn at random."""
    random = np.random.default_rng((*seed, _KNOWN_SEED))
    level = KnownLevel(random.choice(len(KnownLevel), p=SETTINGS.known_shares))
    return hide_above(add_size_errors(sample.known, SETTINGS.size_error, random), level)


class _Batches(Dataset[Batch]):
    """The batches of an epoch by their number."""

    def __init__(self, samples: list[Sample], as_is: list[bool], chosen: np.ndarray,
                 seed: tuple[int, ...], blind_share: float, picture_share: float):
        """`chosen`: (batches, size) rows of the samples."""
        self._samples, self._as_is, self._chosen = samples, as_is, chosen
        self._seed, self._shares = seed, (blind_share, picture_share)

    def __len__(self) -> int:
        return len(self._chosen)

    @override
    def __getitem__(self, number: int) -> Batch:
        samples = [self._samples[i] for i in self._chosen[number]]
        seeds = [(*self._seed, number, k) for k in range(len(samples))]
        inputs = [make_input(self._samples[i], self._as_is[i], seed, *self._shares)
                  for i, seed in zip(self._chosen[number], seeds)]
        x, resolution = (torch.from_numpy(np.stack(part)) for part in zip(*inputs))
        known = np.stack([draw_known(s, seed) for s, seed in zip(samples, seeds)])
        return Batch(x, torch.from_numpy(known), resolution, target_tensor(samples))


def draw_batches(samples: list[Sample], as_is: list[bool], weights: np.ndarray, size: int,
                 count: int, seed: tuple[int, ...], blind_share: float = SETTINGS.blind_share,
                 picture_share: float = SETTINGS.picture_share, processes: int = 0
                 ) -> Iterator[Batch]:
    """Yields batches, prepared ahead; the same whoever prepares them.

    Args:
        samples: what is drawn from.
        as_is: for each sample whether it is not degraded.
        weights: (n,) how often each is drawn, relatively.
        size: samples of a batch.
        count: number of batches.
        seed: of all that is drawn.
        blind_share: probability of a tile without walls and floor.
        picture_share: probability of a cast surface to be degraded as stereo on pictures does.
        processes: number of processes that prepare them; 0: a thread does.
    """
    random = np.random.default_rng(seed)
    chosen = random.choice(len(samples), (count, size), p=weights / weights.sum())
    batches = _Batches(samples, as_is, chosen, seed, blind_share, picture_share)
    yield from prepare_ahead(batches, processes)


def prepare_ahead(batches: Dataset[Any], processes: int = 0) -> Iterator[Any]:
    """Yields all batches of a dataset of batches in their order, prepared ahead.

    Args:
        batches: a batch by its number; it has a length.
        processes: number of processes that prepare them; 0: a thread does.
    """
    if processes:
        # Forked processes share the samples' memory; they touch no accelerator.
        yield from DataLoader(batches, batch_size=None, num_workers=processes,
                              multiprocessing_context="fork",
                              prefetch_factor=SETTINGS.batches_ahead)
        return
    with ThreadPoolExecutor(1) as pool:
        numbers = iter(range(len(batches)))  # type: ignore[arg-type]
        waiting = [pool.submit(batches.__getitem__, n)
                   for n in islice(numbers, SETTINGS.batches_ahead)]
        while waiting:
            ready = waiting.pop(0).result()
            waiting += [pool.submit(batches.__getitem__, n) for n in islice(numbers, 1)]
            yield ready
