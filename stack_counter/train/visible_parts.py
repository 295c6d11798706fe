# SPDX-License-Identifier: Apache-2.0
"""Trains the network that finds the parts that show in a stack's surface.

    python -m stack_counter.train.visible_parts --data data/train-deep --out out/visible-parts

The families of one fold are left out; every epoch is evaluated on them, the best one is kept, and
a run that was ended goes on where it was. The score from which a part is told is the least at
which nine of ten parts found in scenes of these families are there.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from stack_counter.errors import ConfigError
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, network_channels
from stack_counter.sim import match_parts
from stack_counter.tasks.progress import progress
from stack_counter.train.data.batches import assign_folds, prepare_ahead
from stack_counter.train.data.part_tiles import (
    PartBatches,
    PartSample,
    degrade,
    load_part_samples,
)
from stack_counter.train.device import mixed_precision
from stack_counter.train.gamma import family_weights
from stack_counter.train.member import TrainConfig, Training, read_checkpoint
from stack_counter.train.part_net import PartNet, save_part_net
from stack_counter.visible_parts.decoding import PartsInMap, decode_parts
from stack_counter.visible_parts.finder import pad_channels


@dataclass(frozen=True)
class PartTrainingSettings:
    """How the network is evaluated while it learns; chosen.

    Attributes:
        evaluated: scenes of families left out.
        reach: distance from a part's middle within which it is found, part lengths.
        mostly_shown: share from which a part that shows counts as one that should be found.
        precision: share of the parts found that are to be there.
        epochs: passes over the samples.
        processes: that prepare batches for an accelerator.
    """

    evaluated: int = 120
    reach: float = 0.5
    mostly_shown: float = 0.5
    precision: float = 0.9
    epochs: int = 20
    processes: int = 12


SETTINGS = PartTrainingSettings()


def train_part_net(net: PartNet, learnt: list[PartSample], held_out: list[PartSample],
                   config: TrainConfig, path: Path) -> None:
    """Trains the network, from its checkpoint if there is one; the best epoch is kept.

    Args:
        net: untrained.
        learnt: samples to learn from.
        held_out: samples of families left out.
        config: epochs, batch, rate, weights of families and the like; what is the
            gamma-network's alone has no effect.
        path: checkpoint.
    """
    weights = family_weights([s.sample.family for s in learnt], config.family_exponent)
    steps = max(len(learnt) // config.batch, 1)
    training = Training(net, config, steps)
    if path.exists():
        training.load(path)
    device = training.device
    processes = 0 if device.type == "cpu" else SETTINGS.processes
    while not training.is_finished():
        begin, epoch = time.time(), len(training.history)
        # Learn an epoch's batches.
        net.train()
        random = np.random.default_rng((config.seed, epoch))
        chosen = random.choice(len(learnt), (steps, config.batch), p=weights / weights.sum())
        batches = PartBatches(learnt, chosen, (config.seed, epoch))
        losses = []
        for batch in progress(prepare_ahead(batches, processes), f"{path.stem} epoch {epoch}",
                              "steps", steps):
            maps, targets = (part.to(device, non_blocking=True) for part in batch)
            with mixed_precision(device):
                loss = net.loss(maps.to(memory_format=torch.channels_last), targets)
            training.descend(loss)
            losses.append(loss.detach())
        # Evaluate the averaged weights and store all.
        figures = measure_held_out(training.average.module, held_out)
        line = {"epoch": epoch, "loss": sum(map(float, losses)) / steps,
                "score": 1 - figures["average_precision"], **figures,
                "seconds": time.time() - begin}
        print(path.stem, json.dumps({k: round(v, 4) for k, v in line.items()}), flush=True)
        training.end_epoch(line)
        training.save(path)
    net.load_state_dict(read_checkpoint(path)["best"])


def measure_held_out(net: nn.Module, samples: list[PartSample]) -> dict[str, float]:
    """Measures recall of the parts that mostly show, and the threshold of the wanted precision.

    Where no threshold gives that precision, recall is 0 and the threshold 1. `average_precision`
    is over the parts that mostly show; `share_error` is the mean error of the share that shows.
    """
    net.eval()
    scores, right, hits, share_errors, total = [], [], [], [], 0
    for number, labelled in enumerate(samples[:SETTINGS.evaluated]):
        found = find_in_sample(net, labelled, np.random.default_rng((7, number)))
        true = labelled.to_be_found
        match = match_parts(found.centers, labelled.parts.centers[true],
                            SETTINGS.reach * PIXELS_PER_LENGTH)
        true_share = np.append(labelled.parts.shares[true], np.nan)[match]  # NaN: none
        scores.append(found.scores)
        right.append(match >= 0)
        hits.append(true_share > SETTINGS.mostly_shown)
        share_errors.append(np.abs(found.shares - true_share)[match >= 0])
        total += np.count_nonzero(labelled.parts.shares[true] > SETTINGS.mostly_shown)
    errors = np.concatenate(share_errors)
    return {**_judge_scores(*map(np.concatenate, (scores, right, hits)), total),
            "share_error": float(errors.mean()) if len(errors) else 1.0}


def find_in_sample(net: nn.Module, labelled: PartSample, random: np.random.Generator
                   ) -> PartsInMap:
    """Finds parts in the whole surface of a sample, degraded as fusion does, by torch."""
    maps = degrade(labelled.sample, random, picture_share=0.0)
    channels = torch.from_numpy(pad_channels(network_channels(maps)))[None]
    with torch.inference_mode():
        output = net(channels.to(next(net.parameters()).device))[0][0].float().cpu().numpy()
    rows, cols = maps.valid.shape
    return decode_parts(output[:, :rows, :cols], maps.valid)


def _judge_scores(scores: np.ndarray, right: np.ndarray, hits: np.ndarray, total: int
                  ) -> dict[str, float]:
    """Average precision, and the least score at which the parts found are right often enough.

    Args:
        scores: (n,) of parts found in all scenes.
        right: (n,) bool: a part is there.
        hits: (n,) bool: it mostly shows.
        total: parts that mostly show.
    """
    order = np.argsort(-scores)
    hit = hits[order]
    precision = np.cumsum(right[order]) / np.arange(1, len(order) + 1)
    figures = {"recall": 0.0, "threshold": 1.0,
               "average_precision": float(precision[hit].sum() / total)}
    enough = np.flatnonzero(precision >= SETTINGS.precision)
    if len(enough):
        last = enough[-1]
        figures |= {"recall": float(np.count_nonzero(hit[:last + 1]) / total),
                    "threshold": float(scores[order[last]])}
    return figures


def split_by_family(samples: list[PartSample], fold: int
                    ) -> tuple[list[PartSample], list[PartSample]]:
    """Samples to learn from, and those of the families of a fold.

    Raises:
        ConfigError: one of them is empty.
    """
    folds = assign_folds(sorted({s.sample.family for s in samples}))
    learnt = [s for s in samples if folds[s.sample.family] != fold]
    held_out = [s for s in samples if folds[s.sample.family] == fold]
    if not learnt or not held_out:
        raise ConfigError(f"{len(learnt)} samples to learn from and {len(held_out)} of families "
                          f"left out (fold {fold}); expected some of both: name more --data")
    # The first of them are evaluated: not those of one folder alone.
    mixed = np.random.default_rng(0).permutation(len(held_out))
    return learnt, [held_out[i] for i in mixed]


def main(arguments: list[str] | None = None) -> int:
    """Casts what is not cast yet, trains, and writes visible_parts.safetensors."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, nargs="+", required=True, metavar="DIR",
                        help="folders of simulated scenes")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--cache", type=Path, default=Path("out/heights"), metavar="DIR",
                        help="height maps and the parts in them are kept here")
    parser.add_argument("--fold", type=int, default=0, help="whose families are left out")
    parser.add_argument("--scenes", type=int, metavar="N", help="only N of them, drawn at random")
    parser.add_argument("--epochs", type=int, default=SETTINGS.epochs)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, metavar="W", help="that cast")
    options = parser.parse_args(arguments)
    learnt, held_out = split_by_family(
        load_part_samples(options.data, options.cache, options.workers), options.fold)
    if options.scenes:
        chosen = np.random.default_rng([options.seed, 0x5CE]).permutation(len(learnt))
        learnt = [learnt[i] for i in chosen[:options.scenes]]
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(options.seed)
    net = PartNet()
    config = TrainConfig(epochs=options.epochs, batch=options.batch, seed=options.seed)
    train_part_net(net, learnt, held_out, config, options.out / "visible_parts.pt")
    figures = measure_held_out(net, held_out)
    save_part_net(options.out / "visible_parts.safetensors", net.cpu(), {
        "learnt_from": f"{len(learnt)} scenes", "threshold": str(figures["threshold"]),
        "held_out": json.dumps(figures)})
    print(json.dumps(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
