# SPDX-License-Identifier: Apache-2.0
"""Trains the gamma-network: one member for each fold of families, which it does not see.

stack-counter train --data data/train-deep data/train-shallow --out out/gamma
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

import cv2
import numpy as np
import torch

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import make_net
from stack_counter.sim import source_of
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.train.data.batches import FOLDS, assign_folds, family_group
from stack_counter.train.data.fused import read_scans
from stack_counter.train.data.heights import Sample, load_samples
from stack_counter.train.member import (
    TrainConfig,
    TrainingData,
    measure_held_out,
    read_checkpoint,
    read_member,
    train_member,
)
from stack_counter.train.warm_start import begin_as_member


def run(options: argparse.Namespace) -> int:
    """Trains members that are not finished; writes curves."""
    options.out.mkdir(parents=True, exist_ok=True)
    # Cast the height maps here, once, and complain of the folders before any process starts.
    data = load_data(options)
    sources = {source_of(family) for family in data.families}
    if missing := set(options.leave_out_source) - sources:
        raise ConfigError(f"--leave-out-source {' '.join(sorted(missing))}: no scene has such a "
                          f"part; expected some of: {', '.join(sorted(sources - {''})) or 'none'}")
    (options.out / "families.json").write_text(json.dumps(data.families))
    # Each on one core: networks this small lose more by sharing two than they gain.
    with worker_pool(options.workers) as pool:
        for job in [pool.submit(train_fold, options, number)
                    for number in options.folds or range(FOLDS)]:
            job.result()
    plot_curves(options.out)
    return 0


def train_fold(options: argparse.Namespace, number: int) -> None:
    """Trains the member that leaves out fold `number`, in a process of its own."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    # Leave out the families of the fold, and whole sources for good.
    data = load_data(options)
    fold = assign_folds(data.families)
    fold_by_sample = np.array([fold[s.family] for s in data.samples])
    source_by_sample = np.array([source_of(s.family) for s in data.samples])
    foreign = np.isin(source_by_sample, options.leave_out_source)
    learnt = (fold_by_sample != number) & ~foreign
    if options.scenes:
        random = np.random.default_rng([options.seed, 0x5CE])
        chosen = random.permutation(np.flatnonzero(learnt))[:options.scenes]
        learnt = np.isin(np.arange(len(learnt)), chosen)
    # Train.
    config = TrainConfig(epochs=options.epochs or TrainConfig.epochs, rate=options.rate,
                         seed=options.seed)
    torch.manual_seed(options.seed)
    net = make_net(options.encoder, options.encoder_weights)
    if options.start is not None:
        begin_as_member(net, options.start, number)
    path = options.out / f"member_{number}.pt"
    train_member(net, data.select(learnt), data.select((fold_by_sample == number) & ~foreign),
                 config, path, cores=max((os.cpu_count() or 1) // options.workers, 1))
    # Test on the sources left out.
    for source in options.leave_out_source:
        best, _ = read_member(path, options.encoder_weights)
        errors = measure_held_out(best, data.select(source_by_sample == source))
        print(path.stem, "on", source, json.dumps({k: round(v, 4) for k, v in errors.items()}),
              flush=True)


def load_data(options: argparse.Namespace, config: TrainConfig = TrainConfig()) -> TrainingData:
    """Loads samples of the folders (`DIR` or `DIR:WEIGHT`) and fused scans, weighted.

    Raises:
        ConfigError: there is nothing, or a weight is no number.
    """
    samples: list[Sample] = []
    weights: list[float] = []
    for text in map(str, options.data):
        name, _, weight_text = text.partition(":")
        try:
            weight = float(weight_text or 1)
        except ValueError as error:
            raise ConfigError(f"--data {text}: weight '{weight_text}'; expected a number"
                              ) from error
        of_folder = load_samples([Path(name)], options.cache, options.workers)
        samples += of_folder
        weights += [weight] * len(of_folder)
    if not samples:
        raise ConfigError(f"no scenes in {list(map(str, options.data))}; expected shard_*.npz")
    fused = [scan.sample for folder in options.scans for scan in read_scans(folder)
             if scan.found]
    by_family = np.array(weights) * family_weights([s.family for s in samples],
                                                   config.family_exponent)
    return TrainingData(samples + fused, [False] * len(samples) + [True] * len(fused),
                        np.append(by_family, [config.fused_weight] * len(fused)))


def family_weights(families: list[str], exponent: float) -> np.ndarray:
    """(n,) weights of samples, 1 in the mean, by which large groups of families weigh less.

    Args:
        families: of each sample.
        exponent: see `TrainConfig.family_exponent`.
    """
    _, group, size = np.unique([family_group(family) for family in families],
                               return_inverse=True, return_counts=True)
    weights = size[group] ** -exponent
    return weights / weights.mean()


def plot_curves(folder: Path) -> None:
    """Writes `curves.png`: loss and the error on families left out, a line a member."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.2))
    for path in sorted(folder.glob("member_*.pt")):
        history = read_checkpoint(path)["history"]
        axes[0].plot([line["loss"] for line in history], label=path.stem)
        axes[1].plot([line["mae"] for line in history], label=path.stem)
    for axis, title in zip(axes, ("training loss", "gamma MAE, families left out")):
        axis.set_xlabel("epoch")
        axis.set_title(title)
    axes[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(folder / "curves.png", dpi=90)
    pyplot.close(figure)
