# SPDX-License-Identifier: Apache-2.0
"""Parts, their models and scans of them, for tests of what is known of a part."""

import dataclasses

import numpy as np

from stack_counter.occupancy import OccupancyEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import CountedScan
from stack_counter.parts.gamma_model import FEATURES, GammaModel, Reading
from stack_counter.parts.part_models import PartModels
from stack_counter.teaching.simulated_piles import PileScan
from stack_counter.types import (
    Container,
    HeightMap,
    Intrinsics,
    KeyView,
    OccupancyEstimate,
    Reason,
    StackVolume,
    ViewTally,
)

V, SIZE = 1e-6, (0.1, 0.08, 0.05)
COUNTED = CountedScan("2026-01-02", 'bin "7": #', 240, -0.5, -0.4, "network 7", 3.2, 7.5, False,
                      "box", (0.3, 0.2, 0.1), 610.0)


class ConstantEstimator(OccupancyEstimator):
    """An estimator that always says the same."""

    def __init__(self, gamma=0.5, name="network 7"):
        self.gamma, self.name = gamma, name

    def estimate(self, volume, unit_volume):
        return OccupancyEstimate(self.gamma, 0.1 * self.gamma, np.linspace(-2, 2, 99), self.name,
                                 (Reason.FEW_PARTS,))


def stack_volume_of_box(kind="box", size=SIZE, focal=610.0, one_side=False, height=0.03):
    top = np.full((80, 100), height, np.float32)
    maps = [HeightMap(np.eye(4), 0.001, a) for a in (top, np.zeros_like(top))]
    view = KeyView(0, Intrinsics(4, 4, focal, focal, 2.0, 2.0), np.eye(4), 9, np.zeros((4, 4)))
    return StackVolume(0, height * 0.008, 1e-9, Container(kind, np.eye(4), size), (0, 0.5, 1), 1.0,
                       *maps, view, ViewTally(),
                       one_side=one_side)


def gamma_model(shared=0.1, prior=0.03, said=0.04, correlation=0.0, source="piles"):
    """gamma is 0.6 whatever the fill; offsets of t and y, and their noise."""
    b = np.zeros((2, FEATURES))
    b[:, 0] = np.log(0.6)
    both = np.zeros((2, FEATURES, 2, FEATURES))
    both[0, 0, 0, 0] = shared**2
    cross = correlation * prior * said
    return GammaModel(b, both.reshape(2 * FEATURES, -1), np.array([[prior**2, cross],
                                                                   [cross, said**2]]),
                      0.0, np.linspace(-2, 2, 99), np.array([0.5, 4.0]), np.array([-0.3, -0.1]),
                      source)


def gamma_model_with_signal(shared):
    """The estimator follows the part's own offset."""
    made = gamma_model(shared)
    both = made.shared.copy()
    both[0, FEATURES] = both[FEATURES, 0] = both[FEATURES, FEATURES] = shared**2
    return dataclasses.replace(made, shared=both)


def simulated_readings(count, seed=0, far=0):
    """log gamma = -0.6 + 0.3 / (h + 1/2) - 1 / w - 0.2 (mu - 0.45), y 0.1 below it; noise 0.03,
    0.05; V's own error 0.02; the first `far` have a container that was missed."""
    random, out = np.random.default_rng(seed), []
    for i in range(count):
        height, width, mu = random.uniform(0.5, 6), random.uniform(4, 9), random.uniform(0.2, 0.7)
        true = -0.6 + 0.3 / (height + 0.5) - 1 / width - 0.2 * (mu - 0.45)
        noise = random.normal(0, [0.03, 0.05]) + (0.8 if i < far else 0.0) * np.array([1, 0])
        out.append(
            PileScan(Reading(height, width, true - 0.1 + noise[1], true + noise[0]), 0.02, mu)
        )
    return out


def part_with_piles(folder):
    """A part whose simulated piles were read by `ConstantEstimator`; its file is in a folder."""
    PartModels("network 7", gamma_model_with_signal(0.1), gamma_model(0.2), "64 piles").write(
        folder / "nut.json")
    return Part(V, "nut", gamma_prior=folder / "nut.json")


def counted_at(gamma, **changes):
    """A counted scan of `stack_volume_of_box` that found this gamma; the estimator says 0.5."""
    return dataclasses.replace(
        COUNTED, log_gamma=float(np.log(gamma)), said=float(np.log(0.5)), height=3.0, width=9.0,
        inner_size_m=SIZE, **changes)
