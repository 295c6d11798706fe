# SPDX-License-Identifier: Apache-2.0
"""Trains the paper's baselines that count from one colour picture, on rendered key views.

    python -m stack_counter.train.pictures vit_h --data data/train-deep --out out/pictures

The families of one fold are left out; every epoch is evaluated on them, the best one is kept, and
a run that was ended goes on where it was. `--encoder dinov2 --encoder-weights DIR` (or `vit`)
takes the user's frozen encoder for our own small one, `--encoder resnet50` the one of BMNet+.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import nn

from stack_counter.errors import ConfigError
from stack_counter.picture_baselines import KINDS
from stack_counter.picture_baselines.bmnet import BMNet, BMNetConfig
from stack_counter.picture_baselines.encoder import FROZEN
from stack_counter.picture_baselines.net_file import save_net
from stack_counter.picture_baselines.picture_net import (
    PictureNet,
    PictureNetConfig,
    save_picture_net,
)
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.data.picture_batches import (
    PictureBatch,
    draw_rows,
    make_density_batch,
    make_log_batch,
)
from stack_counter.train.data.pictures import SIDE_PX, PictureSample, load_picture_samples
from stack_counter.train.device import mixed_precision
from stack_counter.train.member import TrainConfig, Training, read_checkpoint

_TRAINABLE = ("vit_h", "bmnet", "color")
_EVALUATED_AT_ONCE = 16

MakeBatch = Callable[[list[PictureSample], np.random.Generator | None], PictureBatch]


@dataclass(frozen=True)
class _Learner:
    """What a baseline learns with.

    Attributes:
        net: untrained.
        make_batch: of samples; without a generator they are not turned.
        log_estimates: (n,) logs that the network gives for a batch, and the (n,) true ones.
        save: writes the trained network.
    """

    net: nn.Module
    make_batch: MakeBatch
    log_estimates: Callable[[nn.Module, PictureBatch], tuple[torch.Tensor, torch.Tensor]]
    save: Callable[[Path, nn.Module, dict[str, str]], None]


def make_learner(name: str, encoder: str, encoder_folder: Path | None) -> _Learner:
    """Makes the untrained network of a baseline and what it learns by.

    Raises:
        ConfigError: the baseline has no such encoder.
        WeightsError: the encoder cannot be loaded.
    """
    if name == "bmnet":
        if encoder in FROZEN:
            raise ConfigError(f"--encoder {encoder}: bmnet learns its features; expected own or "
                              "resnet50")
        config = BMNetConfig(encoder=encoder, side_px=SIDE_PX)
        return _Learner(BMNet(config), partial(make_density_batch, config=config),
                        _density_logs, lambda path, net, facts: save_net(path, name, net, facts))
    gives = KINDS[name].gives
    net = PictureNet(PictureNetConfig(encoder, gives, SIDE_PX), encoder_folder)
    return _Learner(net, partial(make_log_batch, gives=gives, side=net.side_px),
                    lambda net, batch: (net(batch[0]), batch[1]),
                    lambda path, net, facts: save_picture_net(path, name, net, facts))


def _density_logs(net: nn.Module, batch: PictureBatch) -> tuple[torch.Tensor, torch.Tensor]:
    density, _ = net(*batch[:-1])
    return tuple(torch.log(d.sum((1, 2)).clamp_min(1e-3)) for d in (density, batch[-1]))


def train_baseline(learner: _Learner, learnt: list[PictureSample], held_out: list[PictureSample],
                   config: TrainConfig, path: Path) -> None:
    """Trains a baseline, from its checkpoint if there is one.

    Args:
        learner: of the baseline.
        learnt: samples to learn from.
        held_out: samples of families left out.
        config: epochs, batch, rate, seed and the like; what is the gamma-network's has no effect.
        path: checkpoint.
    """
    steps = max(len(learnt) // config.batch, 1)
    training = Training(learner.net, config, steps)
    if path.exists():
        training.load(path)
    device = training.device
    while not training.is_finished():
        begin, epoch = time.time(), len(training.history)
        # Learn an epoch's batches.
        learner.net.train()
        batches = _batches(learner, learnt, config, steps, epoch)
        losses = []
        for batch in progress(batches, f"{path.stem} epoch {epoch}", "steps", steps):
            with mixed_precision(device):
                loss = learner.net.loss(*(part.to(device) for part in batch))
            training.descend(loss)
            losses.append(loss.detach())
        # Evaluate the averaged weights and store all.
        line = {"epoch": epoch, "loss": sum(map(float, losses)) / steps,
                **measure_held_out(learner, training.average.module, held_out),
                "seconds": time.time() - begin}
        print(path.stem, json.dumps({k: round(v, 4) for k, v in line.items()}), flush=True)
        training.end_epoch(line)
        training.save(path)
    learner.net.load_state_dict(read_checkpoint(path)["best"])


def _batches(learner: _Learner, samples: list[PictureSample], config: TrainConfig, steps: int,
             epoch: int) -> Iterator[PictureBatch]:
    """An epoch's batches, the same whenever they are made."""
    for number, rows in enumerate(draw_rows(len(samples), config.batch, steps,
                                            (config.seed, epoch))):
        random = np.random.default_rng((config.seed, epoch, number))
        yield learner.make_batch([samples[i] for i in rows], random)


def measure_held_out(learner: _Learner, net: nn.Module, samples: list[PictureSample]
                     ) -> dict[str, float]:
    """Measures errors on samples left out; `score` is the mean error of the log."""
    net.eval()
    device = next(net.parameters()).device
    errors = []
    with torch.no_grad():
        for first in range(0, len(samples), _EVALUATED_AT_ONCE):
            batch = learner.make_batch(samples[first:first + _EVALUATED_AT_ONCE], None)
            estimated, true = learner.log_estimates(net, [part.to(device) for part in batch])
            errors.append((estimated - true).cpu().numpy())
    every = np.concatenate(errors)
    return {"score": float(np.abs(every).mean()), "bias": float(every.mean()),
            "mean_relative_error": float(np.abs(np.expm1(every)).mean())}


def _split(samples: list[PictureSample], fold: int
           ) -> tuple[list[PictureSample], list[PictureSample]]:
    """Samples to learn from, and those of the families of a fold.

    Raises:
        ConfigError: one of them is empty.
    """
    folds = assign_folds(sorted({s.family for s in samples}))
    learnt = [s for s in samples if folds[s.family] != fold]
    held_out = [s for s in samples if folds[s.family] == fold]
    if not learnt or not held_out:
        raise ConfigError(f"{len(learnt)} samples to learn from and {len(held_out)} of families "
                          f"left out (fold {fold}); expected some of both: name more --data")
    return learnt, held_out


def main(arguments: list[str] | None = None) -> int:
    """Renders what is not rendered yet, trains, and writes NAME.safetensors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("baseline", choices=_TRAINABLE)
    parser.add_argument("--data", type=Path, nargs="+", required=True, metavar="DIR",
                        help="folders of simulated scenes")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--cache", type=Path, default=Path("out/pictures-cache"), metavar="DIR",
                        help="rendered pictures are kept here")
    parser.add_argument("--encoder", default="own", choices=("own", "resnet50", *FROZEN))
    parser.add_argument("--encoder-weights", type=Path, metavar="DIR",
                        help="your folder of DINOv2 or ViT")
    parser.add_argument("--fold", type=int, default=0, help="whose families are left out")
    parser.add_argument("--scenes", type=int, metavar="N", help="only N of them, drawn at random")
    parser.add_argument("--epochs", type=int, default=20)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    Workers.add_arguments(parser)
    options = parser.parse_args(arguments)
    samples = load_picture_samples(options.data, options.cache, Workers.of(options))
    learnt, held_out = _split(samples, options.fold)
    if options.scenes:
        chosen = np.random.default_rng([options.seed, 0x5CE]).permutation(len(learnt))
        learnt = [learnt[i] for i in chosen[:options.scenes]]
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(options.seed)
    learner = make_learner(options.baseline, options.encoder, options.encoder_weights)
    config = TrainConfig(epochs=options.epochs, batch=options.batch, seed=options.seed)
    train_baseline(learner, learnt, held_out, config, options.out / f"{options.baseline}.pt")
    errors = measure_held_out(learner, learner.net, held_out)
    facts = {"learnt_from": f"{len(learnt)} rendered key views", "errors": json.dumps(errors)}
    learner.save(options.out / f"{options.baseline}.safetensors", learner.net.cpu(), facts)
    print(json.dumps(errors))
    return 0


if __name__ == "__main__":
    sys.exit(main())
