# SPDX-License-Identifier: Apache-2.0
"""Trains the baseline that says the count straight from the picture.

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
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.data.heights import Sample
from stack_counter.train.gamma import (
    TrainConfig,
    TrainingData,
    add_arguments,
    load_data,
    train_member,
)

_WIDTHS = (16, 32, 48, 64)


def with_log_count_target(sample: Sample) -> Sample:
    """The sample as one framed picture whose answer is its count."""
    return replace(sample, maps=fit_to_tile(sample.maps), gamma=sample.count / TYPICAL_COUNT)


def main() -> int:
    """Trains without the families of one fold; their truly fused scans say its errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.set_defaults(epochs=10, folds=[0])
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    data = load_data(options)
    fold, number = assign_folds(data.families), options.folds[0]
    framed_all = [with_log_count_target(s) for s in data.samples]
    left_out = np.array([fold[s.family] == number for s in data.samples])
    held = TrainingData(framed_all, data.fused, data.weights).select(
        left_out & np.array(data.fused)
    )
    # As they are: a picture of the whole stack is too coarse for noise to matter.
    known = TrainingData(framed_all, [True] * len(left_out), data.weights).select(~left_out)
    torch.manual_seed(options.seed)
    net = GammaNet(NetConfig(widths=_WIDTHS))
    config = TrainConfig(epochs=options.epochs, seed=options.seed, form_weight=0.0)
    path = options.out / "direct.pt"
    train_member(net, known, held, config, path)
    net.load_state_dict(torch.load(path, weights_only=True)["best"])
    predictions = [predict_count(net.eval(), s.maps) for s in held.samples]
    miss = np.array([np.log(s.gamma * TYPICAL_COUNT) - p.log_count
                     for s, p in zip(held.samples, predictions)])
    errors = {"scans": len(miss),
              "count_mean_relative_error": float(np.abs(np.expm1(-miss)).mean())}
    scores = np.sort(miss / np.array([p.std for p in predictions]))
    save_members(options.out / "direct.safetensors", [net],
                 {"learnt": "count", "errors": json.dumps(errors)},
                 {"scores": scores})
    print(json.dumps(errors))
    return 0


if __name__ == "__main__":
    sys.exit(main())
