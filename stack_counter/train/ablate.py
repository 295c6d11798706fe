# SPDX-License-Identifier: Apache-2.0
"""What each part of the network and of its training brings.

2,000 scenes, 10 epochs, families left out fold by fold, whose truly fused scans are evaluated, at
each level of knowledge of the part's form. Every training is one line of `ablation.jsonl`, written
when it ends.

    python -m stack_counter.train.ablate --data data/train-deep:2 ... --scans SCANS --out DIR

The same scenes are evaluated with ideal depth, too. So the paper's ablation is two variants: T-,
learnt from depth as it is measured, is `as shipped`, T+ is `surfaces as cast, not degraded`; D- is
the fused scans, D+ ideal depth. Source: paper, section 4.4 and its tables.

    ... --variants "as shipped" "surfaces as cast, not degraded"
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import as_completed
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
import torch

from stack_counter.occupancy.checkpoint import SHIPPED_NET
from stack_counter.occupancy.gamma_net import GammaNet
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.train.arguments import add_arguments
from stack_counter.train.data.batches import FOLDS, assign_folds
from stack_counter.train.gamma import load_data
from stack_counter.train.member import (
    TrainConfig,
    TrainingData,
    measure_held_out,
    read_member,
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
    "four batches as one": Variant(training={"batch": 128, "rate": 4e-3}),
    "knows v alone": Variant(net={"knows_form": False}),
    "depth cameras alone": Variant(net={"knows_resolution": False}, training={"pictures": 0.0}),
    "all families alike": Variant(training={"family_exponent": 0.0}),
    "squared error, no spread": Variant(training={"likelihood": False}),
    "no form beside gamma": Variant(training={"form_weight": 0.0}),
    "no wall, no floor": Variant(training={"blind": 1.0}),
    "every place counts alike": Variant(net={"by_height": False}),
    "two scales": Variant(net={"scales": 2}),
    "half as wide": Variant(net={"widths": (16, 32, 48, 64)}),
    "wider by half": Variant(net={"widths": (48, 96, 144, 192)}),
    "deeper": Variant(net={"blocks": (2, 3, 4, 3)}),
    "surfaces as cast, not degraded": Variant(training={"degrade": False}),
    "no compound parts": Variant(without="compound"),
    "600 scenes": Variant(scenes=600),
    "all scenes": Variant(scenes=0),
}


_TOLD = ("mae", "r2", "bias", "nae")  # errors that are told of ideal depth as well


def run_variant(options: argparse.Namespace, name: str, number: int, seed: int) -> dict[str, Any]:
    """Trains one variant without the families of one fold and evaluates it on them."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    variant = VARIANTS[name]
    config = replace(TrainConfig(epochs=options.epochs, seed=seed), **variant.training)
    learnt, held_out, ideal = _split(options, variant, config, number)
    # Train.
    torch.manual_seed(seed)
    path = options.out / f"{name.replace(' ', '_').replace(',', '')}_{number}_{seed}.pt"
    train_member(GammaNet(replace(SHIPPED_NET, **variant.net)), learnt, held_out, config, path,
                 cores=max((os.cpu_count() or 1) // options.workers, 1))
    # Evaluate the best epoch; a network that never saw walls is shown none.
    net = read_member(path)[0]
    blind_share = 1.0 if config.blind == 1 else 0.0
    line = {"variant": name, "fold": number, "seed": seed, "scenes": len(learnt.samples),
            **measure_held_out(net, held_out, blind_share)}
    if ideal.samples:
        errors = measure_held_out(net, ideal, blind_share)
        line |= {f"ideal_{key}": errors[key] for key in _TOLD}
    return line


def _split(options: argparse.Namespace, variant: Variant, config: TrainConfig, number: int
           ) -> tuple[TrainingData, TrainingData, TrainingData]:
    """Cast samples to learn from; truly fused ones of the fold left out, and the same as cast."""
    folders = [text for text in map(str, options.data)
               if not variant.without or variant.without not in text]
    everything = load_data(options)
    fold = assign_folds(everything.families)
    held_out = everything.select(np.array([fold[s.family] == number and fused for s, fused in
                                           zip(everything.samples, everything.fused)]))
    learnt = load_data(argparse.Namespace(**{**vars(options), "data": folders, "scans": []}),
                       config)
    allowed = np.flatnonzero([fold[s.family] != number for s in learnt.samples])
    chosen = np.random.default_rng(options.seed).permutation(allowed)[
        :variant.scenes or len(allowed)]
    # The same scenes with ideal depth, which is not degraded.
    cast = {s.name: s for s, fused in zip(everything.samples, everything.fused) if not fused}
    twins = [cast[s.name] for s in held_out.samples if s.name in cast]
    ideal = TrainingData(twins, [True] * len(twins), np.ones(len(twins)))
    return learnt.select(np.isin(np.arange(len(learnt.samples)), chosen)), held_out, ideal


def main() -> int:
    """Prints the table: for each variant the mean over the folds."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS),
                        metavar="NAME")
    parser.add_argument("--seeds", type=int, default=1, metavar="N",
                        help="trainings of each variant and fold")
    parser.set_defaults(epochs=10)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    load_data(options)  # casts what is not cast yet, before the processes need it
    # All variants on one fold before the next, for whatever is done to be comparable.
    jobs = [(name, number, options.seed + k) for k in range(options.seeds)
            for number in options.folds or range(FOLDS) for name in options.variants]
    rows = []
    with worker_pool(options.workers) as pool, \
            open(options.out / "ablation.jsonl", "w", encoding="utf-8") as file:
        for done in as_completed([pool.submit(run_variant, options, *job) for job in jobs]):
            rows.append(done.result())
            print(json.dumps(rows[-1]), file=file, flush=True)
    print_table(rows, options.variants)
    return 0


def print_table(rows: list[dict[str, Any]], names: list[str]) -> None:
    """Prints a line for each variant: its means over folds and seeds."""
    for name in names:
        of_variant = [row for row in rows if row["variant"] == name]
        means = {key: float(np.mean([row[key] for row in of_variant])) for key in of_variant[0]
                 if key != "variant"}
        print(f"{name:32}{of_variant[0]['scenes']:6} scenes  {_format_errors(means)}"
              f"  log error {means['score']:.3f}"
              + "".join(f"  MAE, {title} {means[key]:.3f}"
                        for title, key in (("size known", "mae_size"), ("mesh known", "mae_mesh"))
                        if key in means)
              + (f"  ideal depth: {_format_errors(means, 'ideal_')}" if "ideal_mae" in means
                 else ""))


def _format_errors(means: dict[str, float], prefix: str = "") -> str:
    """Errors of gamma, and the NAE of the count that they alone bring about, V being true."""
    mae, r2, bias, nae = (means[prefix + key] for key in _TOLD)
    return f"MAE {mae:.3f}  R2 {r2:+.2f}  bias {bias:+.3f}  count NAE {nae:.3f}"


if __name__ == "__main__":
    sys.exit(main())
