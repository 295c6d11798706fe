# SPDX-License-Identifier: Apache-2.0
"""What each part of the network and of its training brings.

2,000 scenes, 10 epochs, families left out fold by fold, whose truly fused scans are looked at.

    python -m stack_counter.train.ablate --data data/train-deep:2 ... --scans SCANS --out DIR
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import cv2
import numpy as np
import torch

from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.gamma import (
    TrainConfig,
    add_arguments,
    load_data,
    measure_held_out,
    train_member,
)

_SCENES = 2000
# Name -> changed settings of the network and of the training, scenes (0: all) and, of the names
# of folders, what is left out.
VARIANTS: dict[str, tuple[dict, dict, int, str]] = {
    "as shipped": ({}, {}, _SCENES, ""),
    "squared error, no spread": ({}, {"likelihood": False}, _SCENES, ""),
    "no form beside gamma": ({}, {"form_weight": 0.0}, _SCENES, ""),
    "no wall, no floor": ({}, {"blind": 1.0}, _SCENES, ""),
    "every place counts alike": ({"by_height": False}, {}, _SCENES, ""),
    "two scales": ({"scales": 2}, {}, _SCENES, ""),
    "half as wide": ({"widths": (16, 32, 48, 64)}, {}, _SCENES, ""),
    "surfaces as cast, not degraded": ({}, {"degrade": False}, _SCENES, ""),
    "no compound parts": ({}, {}, _SCENES, "compound"),
    "600 scenes": ({}, {}, 600, ""),
    "all scenes": ({}, {}, 0, ""),
}


def run_variant(job: tuple[argparse.Namespace, str, int]) -> dict:
    """Trains one variant without the families of one fold and looks at them."""
    options, name, number = job
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    of_net, of_training, scenes, without = VARIANTS[name]
    kept = [text for text in map(str, options.data) if not without or without not in text]
    # Of the fused scans only those left out are used: to look at what was learnt.
    data = load_data(options)
    known = load_data(argparse.Namespace(**{**vars(options), "data": kept, "scans": []}))
    fold = assign_folds(data.families)
    held = data.select(np.array([fold[s.family] == number and fused for s, fused in
                               zip(data.samples, data.fused)]))
    allowed = np.flatnonzero([fold[s.family] != number for s in known.samples])
    chosen = np.random.default_rng(options.seed).permutation(allowed)[:scenes or len(allowed)]
    known = known.select(np.isin(np.arange(len(known.samples)), chosen))
    config = replace(TrainConfig(epochs=options.epochs, seed=options.seed), **of_training)
    torch.manual_seed(options.seed)
    path = options.out / f"{name.replace(' ', '_').replace(',', '')}_{number}.pt"
    train_member(GammaNet(replace(NetConfig(), **of_net)), known, held, config, path)
    state = torch.load(path, weights_only=True)
    net = GammaNet(replace(NetConfig(), **of_net))
    net.load_state_dict(state["best"])
    return {"variant": name, "fold": number, "scenes": len(known.samples),
            **measure_held_out(net.eval(), held, 1.0 if config.blind == 1 else 0.0)}


def main() -> int:
    """Prints the table, of each variant the mean over the folds."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS),
                        metavar="NAME")
    parser.set_defaults(epochs=10)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    load_data(options)  # casts what is not cast yet
    jobs = [(options, name, number) for name in options.variants for number in options.folds]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        rows = list(pool.map(run_variant, jobs))
    (options.out / "ablation.json").write_text(json.dumps(rows, indent=1) + "\n")
    for name in options.variants:
        of = [row for row in rows if row["variant"] == name]
        mae, r2, bias, score = (np.mean([row[key] for row in of])
                                for key in ("mae", "r2", "bias", "score"))
        print(f"{name:32}{of[0]['scenes']:6} scenes  MAE {mae:.3f}  R2 {r2:+.2f}  "
              f"bias {bias:+.3f}  log error {score:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
