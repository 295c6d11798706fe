# SPDX-License-Identifier: Apache-2.0
"""Whether a small classifier tells degraded surfaces from reconstructed ones, patch by patch.

It has not seen the families of the parts that it judges. 50% is what guessing reaches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional

from stack_counter.occupancy.maps import PIXELS_PER_LENGTH
from stack_counter.train.data.surface_pairs import SurfacePair


@dataclass(frozen=True)
class PatchSettings:
    """Patches and the classifier; all chosen.

    Attributes:
        side: of a patch, part lengths.
        step: from a patch to the next, part lengths.
        border: part lengths that are left out beside the border of the map.
        limit: largest height over the patch's mean, part lengths.
        draws: surfaces that are degraded of each pair to learn from; one more is judged.
        folds: groups of families, each judged by a classifier that learnt from the others.
        width, steps, batch, rate: of the classifier and of how it learns.
    """

    side: float = 2.0
    step: float = 0.5
    border: float = 0.75
    limit: float = 2.0
    draws: int = 3
    folds: int = 4
    width: int = 16
    steps: int = 300
    batch: int = 128
    rate: float = 4e-3


SETTINGS = PatchSettings()

Degradation = Callable[[SurfacePair, np.random.Generator], np.ndarray]


@dataclass(frozen=True, eq=False)
class PairPatches:
    """Patches of one pair: (n, side, side) float32 heights over their mean, part lengths.

    Attributes:
        family: of the part's shape.
        resolution: part lengths.
        true: as reconstructed.
        degraded: (draws + 1) times as many, degraded anew for each draw.
    """

    family: str
    resolution: float
    true: np.ndarray
    degraded: list[np.ndarray]


def inside(pair: SurfacePair) -> np.ndarray:
    """(rows, cols) bool: valid, and away from the border."""
    side = 2 * int(SETTINGS.border * PIXELS_PER_LENGTH) + 1
    padded = np.pad(pair.valid, 1).astype(np.uint8)
    return cv2.erode(padded, np.ones((side, side)))[1:-1, 1:-1] > 0


def cut_patches(top: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Cuts (n, side, side) float32 patches that lie wholly in a (rows, cols) bool mask."""
    side, step = (int(x * PIXELS_PER_LENGTH) for x in (SETTINGS.side, SETTINGS.step))
    if min(top.shape) < side:
        return np.zeros((0, side, side), np.float32)
    views, whole = (np.lib.stride_tricks.sliding_window_view(a, (side, side))[::step, ::step]
                    for a in (top, usable))
    patches = views[whole.all(axis=(2, 3))]
    return np.clip(patches - patches.mean(axis=(1, 2), keepdims=True), -SETTINGS.limit,
                   SETTINGS.limit).astype(np.float32)


def patches_of(pairs: Sequence[SurfacePair], degrade: Degradation) -> list[PairPatches]:
    """Cuts patches of pairs, as reconstructed and as degraded from what was cast."""
    return [PairPatches(pair.family, pair.resolution, cut_patches(pair.top, inside(pair)), [
        cut_patches(degrade(pair, np.random.default_rng([i, k])), inside(pair))
        for k in range(SETTINGS.draws + 1)]) for i, pair in enumerate(pairs)]


class PatchClassifier(nn.Module):
    """A few convolutions on a patch and its resolution; gives the logit of being true."""

    def __init__(self) -> None:
        """Builds an untrained classifier."""
        super().__init__()
        w = SETTINGS.width
        layers: list[nn.Module] = []
        for before, after, stride in ((2, w, 1), (w, w, 2), (w, 2 * w, 2)):
            layers += [nn.Conv2d(before, after, 3, stride, 1, bias=False), nn.BatchNorm2d(after),
                       nn.ReLU()]
        self.features = nn.Sequential(*layers)
        self.head = nn.Sequential(nn.Dropout(0.3), nn.Linear(4 * w, 1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(b, 2, side, side) heights and log resolution -> (b,)."""
        features = self.features(x)
        pooled = torch.cat([features.mean((2, 3)), features.amax((2, 3))], 1)
        return self.head(pooled)[:, 0]


def classify(items: Sequence[PairPatches], seed: int = 0) -> list[float]:
    """Shares of the patches of each pair that are told right, the two kinds weighing alike.

    NaN for a pair without a whole patch.
    """
    families = sorted({item.family for item in items})
    order = np.random.default_rng(seed).permutation(len(families)) % SETTINGS.folds
    fold = dict(zip(families, order))
    shares = [float("nan")] * len(items)
    for number in range(SETTINGS.folds):
        judged = [i for i, item in enumerate(items)
                  if fold[item.family] == number and len(item.true)]
        learnt = [item for item in items if fold[item.family] != number and len(item.true)]
        if not judged or not learnt:
            continue
        net = _learn(learnt, seed)
        with torch.no_grad():
            for i in judged:
                true, degraded = (net(_inputs(patches, items[i].resolution)).numpy() > 0
                                  for patches in (items[i].true, items[i].degraded[-1]))
                shares[i] = float((true.mean() + 1 - degraded.mean()) / 2)
    return shares


def _inputs(patches: np.ndarray, resolution: float) -> torch.Tensor:
    """(n, 2, side, side) inputs of (n, side, side) patches."""
    return torch.from_numpy(np.stack(
        [patches, np.full_like(patches, np.log(resolution) + 2)], axis=1))


def _learn(items: Sequence[PairPatches], seed: int) -> PatchClassifier:
    """Trains a classifier on pairs, each of which weighs alike in both kinds."""
    torch.manual_seed(seed)
    parts = [(item, patches, label, 1 / count) for item in items for label, kind, count in (
        (1.0, [item.true], 1), (0.0, item.degraded[:-1], SETTINGS.draws))
        for patches in kind]
    x = torch.cat([_inputs(patches, item.resolution) for item, patches, _, _ in parts])
    y = torch.cat([torch.full((len(patches),), label) for _, patches, label, _ in parts])
    weights = torch.cat([torch.full((len(patches),), share) for _, patches, _, share in parts])
    net = PatchClassifier()
    optimizer = torch.optim.AdamW(net.parameters(), SETTINGS.rate, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, SETTINGS.rate,
                                                   total_steps=SETTINGS.steps + 1)
    for step in range(SETTINGS.steps):
        chosen = torch.multinomial(weights, SETTINGS.batch, replacement=True)
        turned = torch.rot90(x[chosen], step % 4, (2, 3))
        turned = turned.flip(3) if step % 8 > 3 else turned
        loss = functional.binary_cross_entropy_with_logits(net(turned), y[chosen])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return net.eval()
