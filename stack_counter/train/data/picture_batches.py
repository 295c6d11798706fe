# SPDX-License-Identifier: Apache-2.0
"""Batches of colour key views: turned, mirrored, brighter and darker."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import torch

from stack_counter.picture_baselines.bmnet import MAX_EXEMPLARS, BMNetConfig, cut_exemplars
from stack_counter.picture_baselines.picture import normalized
from stack_counter.train.data.pictures import SIDE_PX, PictureSample

# What a network's loss takes, the target last.
PictureBatch = Sequence[torch.Tensor]

_BRIGHTNESS_STD = 0.15  # of the log of the gain; chosen
_DENSITY_SIDE = SIDE_PX // 8  # as the network gives it
_DENSITY_SIGMA_CELLS = 1.0  # of the blob of one part; chosen


def draw_rows(samples: int, batch: int, steps: int, seed: tuple[int, ...]) -> np.ndarray:
    """(steps, batch) rows of the samples, each as often as the others if it can be."""
    random = np.random.default_rng(seed)
    rounds = -(-steps * batch // samples)
    rows = np.concatenate([random.permutation(samples) for _ in range(rounds)])
    return rows[:steps * batch].reshape(steps, batch)


def make_log_batch(samples: list[PictureSample], random: np.random.Generator | None, gives: str,
                   side: int) -> PictureBatch:
    """Pictures (b, 3, side, side) and the (b,) logs of the count or of gamma.

    Args:
        samples: b of them.
        random: turns them and changes their brightness; None leaves them as they are.
        gives: `count` or `gamma`.
        side: of the pictures, pixels.
    """
    pictures = [cv2.resize(_altered(s.color, random), (side, side)) for s in samples]
    logs = np.log([float(getattr(s, gives)) for s in samples])
    return [torch.from_numpy(normalized(np.stack(pictures))),
            torch.from_numpy(logs.astype(np.float32))]


def make_density_batch(samples: list[PictureSample], random: np.random.Generator | None,
                       config: BMNetConfig) -> PictureBatch:
    """Pictures, exemplars and densities as `BMNet.loss` takes them.

    Exemplars are the parts that show most; while it learns they are drawn from the better half.
    """
    pictures, patches, scales, densities = [], [], [], []
    for sample in samples:
        density = density_map(sample.centers)
        chosen = np.arange(MAX_EXEMPLARS) % max(len(sample.boxes), 1)
        if random is not None and len(sample.boxes) > 1:
            chosen = random.integers((len(sample.boxes) + 1) // 2, size=MAX_EXEMPLARS)
        exemplars = cut_exemplars(sample.color, sample.boxes[chosen], config)
        turns, mirrored = _draw_turn(random)
        pictures.append(_turned(_brightened(sample.color, random), turns, mirrored))
        densities.append(_turned(density, turns, mirrored))
        patches.append(exemplars.patches)
        scales.append(exemplars.scales)
    return [torch.from_numpy(part) for part in (
        normalized(np.stack(pictures)), np.stack(patches), np.stack(scales),
        np.stack(densities))]


def density_map(centers: np.ndarray) -> np.ndarray:
    """(_DENSITY_SIDE, _DENSITY_SIDE) float32 whose sum is the number of (k, 2) centres."""
    cells = np.arange(_DENSITY_SIDE)
    places = (centers + 0.5) * _DENSITY_SIDE / SIDE_PX - 0.5  # (k, 2) in cells
    x, y = (np.exp(-((cells - places[:, [axis]]) / _DENSITY_SIGMA_CELLS) ** 2 / 2)
            for axis in (0, 1))  # (k, cells)
    x, y = (blob / blob.sum(1, keepdims=True) for blob in (x, y))
    return np.einsum("ki,kj->ij", y, x).astype(np.float32)


def _altered(color: np.ndarray, random: np.random.Generator | None) -> np.ndarray:
    """A picture turned and brightened at random."""
    return _turned(_brightened(color, random), *_draw_turn(random))


def _draw_turn(random: np.random.Generator | None) -> tuple[int, bool]:
    """Number of quarter turns, and whether the picture is mirrored."""
    return (0, False) if random is None else (int(random.integers(4)), bool(random.integers(2)))


def _turned(image: np.ndarray, turns: int, mirrored: bool) -> np.ndarray:
    turned = np.rot90(image, turns)
    return np.ascontiguousarray(turned[:, ::-1] if mirrored else turned)


def _brightened(color: np.ndarray, random: np.random.Generator | None) -> np.ndarray:
    """The colours times a gain that is drawn."""
    if random is None:
        return color
    gain = np.exp(random.normal(0, _BRIGHTNESS_STD))
    return np.clip(color * gain, 0, 255).astype(np.uint8)
