# SPDX-License-Identifier: Apache-2.0
"""Which part each pixel of a sample's maps shows, and tiles of them to learn from."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.utils.data import Dataset
from typing_extensions import override

from stack_counter.errors import ConfigError
from stack_counter.occupancy.maps import (
    PIXELS_PER_LENGTH,
    TILE,
    StackMaps,
    network_channels,
)
from stack_counter.sim import PartsFromAbove, parts_from_above, read_shard
from stack_counter.train.data.batches import draw_tile_place, warp_maps
from stack_counter.train.data.degrade import degrade_like_fusion
from stack_counter.train.data.heights import Sample, load_samples, store_missing
from stack_counter.train.data.stereo_surface import degrade_like_stereo, draw_resolution
from stack_counter.train.part_net import KNOWN
from stack_counter.visible_parts.decoding import COLS, MIDDLE, OUTPUTS, ROWS, SHARE, SHOWN

_CACHE_VERSION = "parts 1"


@dataclass(frozen=True)
class PartTileSettings:
    """What the network is to find; chosen.

    Attributes:
        least_share: share of a part that shows, from which its middle is to be found.
        least_px: pixels that show it, the same.
        middle_std: standard deviation of a middle in the heat map, part lengths.
        picture_share: share of the surfaces that are degraded as stereo on pictures does.
    """

    least_share: float = 0.1
    least_px: int = 5
    middle_std: float = 0.15
    picture_share: float = 0.15


SETTINGS = PartTileSettings()


@dataclass(frozen=True, eq=False)
class PartSample:
    """A sample with the parts that it shows, which lie on the grid of its maps."""

    sample: Sample
    parts: PartsFromAbove

    @property
    def known(self) -> np.ndarray:
        """(rows, cols) bool: some view of the arc sees it, so the surface there is the part's."""
        assert self.sample.seen_by is not None  # samples with parts are cast
        return self.sample.seen_by > 0

    @property
    def to_be_found(self) -> np.ndarray:
        """(k,) bool: enough of the part shows."""
        return (self.parts.shares >= SETTINGS.least_share) \
            & (self.parts.cell_counts >= SETTINGS.least_px)


def load_part_samples(folders: list[Path], cache: Path, workers: int) -> list[PartSample]:
    """Loads all scenes with parts in them, as `load_samples` does; parts are kept beside heights.

    Raises:
        ConfigError: there is no scene.
    """
    samples = load_samples(folders, cache, workers)
    if not samples:
        raise ConfigError(f"no scenes in {list(map(str, folders))}; expected shard_*.npz")
    paths = [path for folder in folders for path in sorted(folder.glob("shard_*.npz"))]
    jobs = [(path, _cache_file(cache, path)) for path in paths]
    store_missing(jobs, _store_parts, "visible parts", workers)
    parts = [parts for _, kept in jobs for parts in _read_parts(kept)]
    return [PartSample(*pair) for pair in zip(samples, parts, strict=True)]


def degrade(sample: Sample, random: np.random.Generator,
            picture_share: float = SETTINGS.picture_share) -> StackMaps:
    """Makes a sample's maps as fusion shows them, or as stereo on pictures does."""
    if random.random() < picture_share:
        return degrade_like_stereo(sample, draw_resolution(sample.part_length_m, random), random)
    return degrade_like_fusion(sample, random)


def make_tile(labelled: PartSample, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Makes network input and targets of a tile at a random place, turn and mirroring.

    Returns:
        (CHANNELS, TILE, TILE) and (OUTPUTS + 1, TILE, TILE) float32.
    """
    maps, parts = degrade(labelled.sample, random), labelled.parts
    place = draw_tile_place(maps.valid.shape, random)
    tile = warp_maps(maps, place)
    numbers, known = (
        cv2.warpAffine(a, place, (TILE, TILE), flags=cv2.INTER_NEAREST, borderValue=outside)
        for a, outside in ((parts.numbers, -1), (labelled.known.astype(np.uint8), 0)))
    x_y = parts.centers[:, ::-1] @ place[:, :2].T + place[:, 2]
    targets = make_targets(numbers, x_y[:, ::-1], parts.shares, labelled.to_be_found)
    targets[KNOWN] = tile.valid & (known > 0)
    return network_channels(tile), targets


def make_targets(numbers: np.ndarray, centers: np.ndarray, shares: np.ndarray,
                 to_be_found: np.ndarray) -> np.ndarray:
    """Makes what the network is to answer.

    Args:
        numbers: (rows, cols) int16 part that each pixel shows; -1 where none is.
        centers: (k, 2) row and column of the parts' middles.
        shares: (k,) share of each that shows.
        to_be_found: (k,) bool whose middles are in the heat map.

    Returns:
        (OUTPUTS + 1, rows, cols) float32, all `KNOWN`.
    """
    shape = numbers.shape
    targets = np.zeros((OUTPUTS + 1, *shape), np.float32)
    targets[KNOWN] = 1
    # What each pixel shows.
    rows, cols = np.nonzero(numbers >= 0)
    part = numbers[rows, cols]
    targets[SHOWN, rows, cols] = 1
    targets[SHARE, rows, cols] = shares[part]
    for output, here, axis in ((ROWS, rows, 0), (COLS, cols, 1)):
        targets[output, rows, cols] = (centers[part, axis] - here) / PIXELS_PER_LENGTH
    # The heat map: a Gaussian around each middle.
    middles = np.round(centers[to_be_found]).astype(int)
    middles = middles[((middles >= 0) & (middles < shape)).all(axis=1)]
    if len(middles):
        elsewhere = np.ones(shape, np.uint8)
        elsewhere[tuple(middles.T)] = 0
        distance = cv2.distanceTransform(elsewhere, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        sigma = SETTINGS.middle_std * PIXELS_PER_LENGTH
        targets[MIDDLE] = np.exp(-(distance / sigma) ** 2 / 2)
    return targets


class PartBatches(Dataset[tuple[torch.Tensor, torch.Tensor]]):
    """The batches of an epoch by their number: inputs (b, CHANNELS, ...) and their targets."""

    def __init__(self, samples: list[PartSample], chosen: np.ndarray, seed: tuple[int, ...]):
        """`chosen`: (batches, size) rows of the samples; `seed`: of all that is drawn."""
        self._samples, self._chosen, self._seed = samples, chosen, seed

    def __len__(self) -> int:
        return len(self._chosen)

    @override
    def __getitem__(self, number: int) -> tuple[torch.Tensor, torch.Tensor]:
        tiles = [make_tile(self._samples[i], np.random.default_rng((*self._seed, number, k)))
                 for k, i in enumerate(self._chosen[number])]
        x, targets = (torch.from_numpy(np.stack(part)) for part in zip(*tiles))
        return x, targets


def _cache_file(cache: Path, shard: Path) -> Path:
    """Where a shard's parts are kept: another content of the shard is another file."""
    digest = zlib.crc32(shard.read_bytes() + _CACHE_VERSION.encode())
    return cache / f"{shard.parent.name}_{shard.stem}_parts_{digest:08x}.npz"


def _store_parts(job: tuple[Path, Path]) -> None:
    """Finds the parts that show in each scene of a shard, and keeps them in a file."""
    shard, kept = job
    parts = [parts_from_above(scene) for scene in read_shard(shard) if scene.truth.count]
    unfinished = kept.with_suffix(".part")
    with unfinished.open("wb") as file:
        np.savez_compressed(file, scenes=len(parts), **{
            f"{i}_{name}": value for i, p in enumerate(parts)
            for name, value in (("numbers", p.numbers), ("shares", p.shares))})
    unfinished.replace(kept)


def _read_parts(kept: Path) -> list[PartsFromAbove]:
    with np.load(kept, allow_pickle=False) as file:
        return [PartsFromAbove(file[f"{i}_numbers"], file[f"{i}_shares"])
                for i in range(int(file["scenes"]))]
