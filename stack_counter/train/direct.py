# SPDX-License-Identifier: Apache-2.0
"""Trains the baseline that counts straight from the picture.

python -m stack_counter.train.direct --data data/train-deep:2 ... --scans SCANS --out OUT
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace

import numpy as np
import torch

from stack_counter.occupancy.checkpoint import save_members
from stack_counter.occupancy.direct_count import TYPICAL_COUNT, fit_to_tile, predict_count
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.train.arguments import add_arguments
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.data.heights import Sample
from stack_counter.train.gamma import load_data
from stack_counter.train.member import TrainConfig, TrainingData, train_member

_WIDTHS = (16, 32, 48, 64)


def to_learn_count(sample: Sample) -> Sample:
    """Returns the sample as one framed picture; in the place of gamma stands its count."""
    return replace(sample, maps=fit_to_tile(sample.maps), gamma=sample.count / TYPICAL_COUNT)


def main() -> int:
    """Trains without the families of one fold; measures errors on their truly fused scans."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.set_defaults(epochs=10, folds=[0])
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    # Frame all stacks; leave out a fold.
    data = load_data(options)
    fold, number = assign_folds(data.families), options.folds[0]
    framed = [to_learn_count(s) for s in data.samples]
    left_out = np.array([fold[s.family] == number for s in data.samples])
    held_out = TrainingData(framed, data.fused, data.weights).select(
        left_out & np.array(data.fused))
    # Not degraded: a picture of the whole stack is too coarse for noise to matter.
    learnt = TrainingData(framed, [True] * len(left_out), data.weights).select(~left_out)
    # Train.
    torch.manual_seed(options.seed)
    net = GammaNet(NetConfig(widths=_WIDTHS))
    config = TrainConfig(epochs=options.epochs, seed=options.seed, form_weight=0.0)
    path = options.out / "direct.pt"
    train_member(net, learnt, held_out, config, path)
    net.load_state_dict(torch.load(path, weights_only=True)["best"])
    # Measure the errors on the fold left out, and write.
    predictions = [predict_count(net.eval(), s.maps) for s in held_out.samples]
    log_ratios = np.array([np.log(s.gamma * TYPICAL_COUNT) - p.log_count
                           for s, p in zip(held_out.samples, predictions)])
    errors = {"scans": len(log_ratios),
              "count_mean_relative_error": float(np.abs(np.expm1(-log_ratios)).mean())}
    scores = np.sort(log_ratios / np.array([p.std for p in predictions]))
    save_members(options.out / "direct.safetensors", [net],
                 {"learnt": "count", "errors": json.dumps(errors)}, {"scores": scores})
    print(json.dumps(errors))
    return 0


if __name__ == "__main__":
    sys.exit(main())
