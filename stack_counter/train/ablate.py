# SPDX-License-Identifier: Apache-2.0
"""What each part of the network and of its training brings.

2,000 scenes, 10 epochs, families left out fold by fold, whose truly fused scans are evaluated.

    python -m stack_counter.train.ablate --data data/train-deep:2 ... --scans SCANS --out DIR
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
import torch

from stack_counter.child_processes import worker_pool
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.train.arguments import add_arguments
from stack_counter.train.data.batches import FOLDS, assign_folds
from stack_counter.train.gamma import load_data
from stack_counter.train.member import (
    TrainConfig,
    TrainingData,
    measure_held_out,
    train_member,
)


@dataclass(frozen=True)
class Variant:
    """One thing done otherwise than as shipped.

    Attributes:
        net: changed settings of `NetConfig`.
        training: changed settings of `TrainConfig`.
        scenes: number of scenes learnt from; 0: all.
        without: folders whose names hold this text are left out; "": none.
    """

    net: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)
    scenes: int = 2000
    without: str = ""


VARIANTS = {
    "as shipped": Variant(),
    "squared error, no spread": Variant(training={"likelihood": False}),
    "no form beside gamma": Variant(training={"form_weight": 0.0}),
    "no wall, no floor": Variant(training={"blind": 1.0}),
    "every place counts alike": Variant(net={"by_height": False}),
    "two scales": Variant(net={"scales": 2}),
    "half as wide": Variant(net={"widths": (16, 32, 48, 64)}),
    "surfaces as cast, not degraded": Variant(training={"degrade": False}),
    "no compound parts": Variant(without="compound"),
    "600 scenes": Variant(scenes=600),
    "all scenes": Variant(scenes=0),
}


def run_variant(job: tuple[argparse.Namespace, str, int]) -> dict[str, Any]:
    """Trains one variant without the families of one fold and evaluates it on them."""
    options, name, number = job
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    variant = VARIANTS[name]
    learnt, held_out = _split(options, variant, number)
    # Train.
    config = replace(TrainConfig(epochs=options.epochs, seed=options.seed), **variant.training)
    torch.manual_seed(options.seed)
    path = options.out / f"{name.replace(' ', '_').replace(',', '')}_{number}.pt"
    net_config = replace(NetConfig(), **variant.net)
    train_member(GammaNet(net_config), learnt, held_out, config, path)
    # Evaluate the best epoch; a network that never saw walls is shown none.
    net = GammaNet(net_config)
    net.load_state_dict(torch.load(path, weights_only=True)["best"])
    blind_share = 1.0 if config.blind == 1 else 0.0
    return {"variant": name, "fold": number, "scenes": len(learnt.samples),
            **measure_held_out(net.eval(), held_out, blind_share)}


def _split(options: argparse.Namespace, variant: Variant, number: int
           ) -> tuple[TrainingData, TrainingData]:
    """Cast samples to learn from, and truly fused ones of the fold that is left out."""
    folders = [text for text in map(str, options.data)
               if not variant.without or variant.without not in text]
    everything = load_data(options)
    fold = assign_folds(everything.families)
    held_out = everything.select(np.array([fold[s.family] == number and fused for s, fused in
                                           zip(everything.samples, everything.fused)]))
    learnt = load_data(argparse.Namespace(**{**vars(options), "data": folders, "scans": []}))
    allowed = np.flatnonzero([fold[s.family] != number for s in learnt.samples])
    chosen = np.random.default_rng(options.seed).permutation(allowed)[
        :variant.scenes or len(allowed)]
    return learnt.select(np.isin(np.arange(len(learnt.samples)), chosen)), held_out


def main() -> int:
    """Prints the table: for each variant the mean over the folds."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS),
                        metavar="NAME")
    parser.set_defaults(epochs=10)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    load_data(options)  # casts what is not cast yet, before the processes need it
    jobs = [(options, name, number) for name in options.variants
            for number in options.folds or range(FOLDS)]
    with worker_pool(options.workers) as pool:
        rows = list(pool.map(run_variant, jobs))
    (options.out / "ablation.json").write_text(json.dumps(rows, indent=1) + "\n")
    for name in options.variants:
        of_variant = [row for row in rows if row["variant"] == name]
        mae, r2, bias, score = (np.mean([row[key] for row in of_variant])
                                for key in ("mae", "r2", "bias", "score"))
        print(f"{name:32}{of_variant[0]['scenes']:6} scenes  MAE {mae:.3f}  R2 {r2:+.2f}  "
              f"bias {bias:+.3f}  log error {score:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
