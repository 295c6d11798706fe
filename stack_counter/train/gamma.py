# SPDX-License-Identifier: Apache-2.0
"""Trains the gamma-network: one member for each fold of families, which it does not see.

stack-counter train --data data/train-deep data/train-shallow --out out/gamma
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from tqdm import tqdm

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import make_net
from stack_counter.occupancy.gamma_net import GammaNet
from stack_counter.train.data.batches import (
    BLIND,
    FOLDS,
    assign_folds,
    draw_batches,
    make_input,
    target_tensor,
)
from stack_counter.train.data.fused import read_scans
from stack_counter.train.data.heights import Sample, load_samples

_WATCHED = 400  # samples of families left out that are looked at after an epoch


@dataclass(frozen=True)
class TrainConfig:
    """How to learn.

    Attributes:
        epochs: passes; an epoch draws as many samples as there are.
        batch: tiles.
        rate: highest learning rate of the one cycle.
        decay: weight decay.
        patience: epochs without progress on the families left out after which it stops.
        seed: of weights, batches and augmentation.
        likelihood, form_weight: see `GammaNet.loss`.
        blind: share of tiles without wall and floor.
        degrade: as fusion does; else surfaces are learnt from as cast.
    """

    epochs: int = 20
    batch: int = 32
    rate: float = 2e-3
    decay: float = 0.05
    patience: int = 10
    seed: int = 0
    likelihood: bool = True
    form_weight: float = 0.02
    blind: float = BLIND
    degrade: bool = True


@dataclass(frozen=True)
class TrainingData:
    """Samples, which of them were truly fused, and how often each is drawn."""

    samples: list[Sample]
    fused: list[bool]
    weights: np.ndarray

    @property
    def families(self) -> list[str]:
        """Their names, sorted."""
        return sorted({s.family for s in self.samples})

    def select(self, chosen: np.ndarray) -> TrainingData:
        """Those of a (n,) bool mask."""
        at = np.flatnonzero(chosen)
        return TrainingData(
            [self.samples[i] for i in at], [self.fused[i] for i in at], self.weights[at]
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `train`."""
    parser.add_argument("--data", type=Path, nargs="+", required=True, metavar="DIR",
                        help="folders of simulated scenes; DIR:W draws them W times as often")
    parser.add_argument("--scans", type=Path, nargs="+", default=[], metavar="DIR",
                        help="truly fused scans of them (python -m stack_counter.train.scans)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--cache", type=Path, default=Path("out/heights"), metavar="DIR",
                        help="height maps are kept here")
    parser.add_argument("--folds", type=int, nargs="+", default=list(range(FOLDS)), metavar="K",
                        help="members to train; each leaves out the families of its fold")
    parser.add_argument("--epochs", type=int, default=TrainConfig.epochs, metavar="N")
    parser.add_argument("--scenes", type=int, metavar="N", help="only N of them, drawn at random")
    parser.add_argument("--encoder", default="own", choices=("own", "dinov2"),
                        help="dinov2: the paper's network, for comparison")
    parser.add_argument("--encoder-weights", type=Path, metavar="DIR",
                        help="your own folder of DINOv2 (config.json, safetensors)")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--workers", type=int, default=2, metavar="W",
                        help="members trained at a time, each on one core")


def run(options: argparse.Namespace) -> int:
    """Trains members that are not finished; writes curves."""
    options.out.mkdir(parents=True, exist_ok=True)
    data = load_data(options)  # casts the height maps; says what is wrong with the folders
    (options.out / "families.json").write_text(json.dumps(data.families))
    # Each on one core: networks this small lose more by sharing two than they gain.
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for job in [pool.submit(train_fold, options, number) for number in options.folds]:
            job.result()
    plot_curves(options.out)
    return 0


def train_fold(options: argparse.Namespace, number: int) -> None:
    """One member, in a process of its own."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    data = load_data(options)
    fold = assign_folds(data.families)
    of = np.array([fold[s.family] for s in data.samples])
    kept = of != number
    if options.scenes:
        random = np.random.default_rng([options.seed, 0x5CE])
        few = random.permutation(np.flatnonzero(kept))[:options.scenes]
        kept = np.isin(np.arange(len(of)), few)
    config = TrainConfig(epochs=options.epochs, seed=options.seed)
    torch.manual_seed(options.seed)
    net = make_net(options.encoder, options.encoder_weights)
    train_member(net, data.select(kept), data.select(of == number), config,
                 options.out / f"member_{number}.pt")


def load_data(options: argparse.Namespace) -> TrainingData:
    """Samples of the folders (`DIR` or `DIR:WEIGHT`) and of fused scans.

    Raises:
        ConfigError: nothing there, or a weight that is no number.
    """
    samples: list[Sample] = []
    weights: list[float] = []
    for text in map(str, options.data):
        name, _, share = text.partition(":")
        try:
            weight = float(share or 1)
        except ValueError as error:
            raise ConfigError(f"--data {text}: weight '{share}'; expected a number") from error
        found = load_samples([Path(name)], options.cache, options.workers)
        samples += found
        weights += [weight] * len(found)
    if not samples:
        raise ConfigError(f"no scenes in {list(map(str, options.data))}; expected shard_*.npz")
    cast = len(samples)
    fused = [scan.sample for folder in options.scans for scan in read_scans(folder)
             if scan.found]
    return TrainingData(samples + fused, [False] * cast + [True] * len(fused),
                np.array(weights + [3.0] * len(fused)))


def train_member(
    net: nn.Module, data: TrainingData, held: TrainingData, config: TrainConfig, path: Path
) -> None:
    """Trains one network, from its checkpoint if there is one; the best epoch is kept."""
    net = net.to(memory_format=torch.channels_last)
    average = AveragedModel(net, multi_avg_fn=get_ema_multi_avg_fn(0.995), use_buffers=True)
    steps = max(len(data.samples) // config.batch, 1)
    optimizer = torch.optim.AdamW(net.parameters(), config.rate, weight_decay=config.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, config.rate,
                                                   config.epochs * steps + 1, pct_start=0.2)
    parts = {"net": net, "average": average, "optimizer": optimizer, "schedule": schedule}
    history: list[dict] = []
    best: dict[str, torch.Tensor] = {}
    if path.exists():
        state = torch.load(path, weights_only=True)
        for name, part in parts.items():
            part.load_state_dict(state[name])
        history, best = state["history"], state["best"]
    while len(history) < config.epochs and _makes_progress(history, config.patience):
        begin, epoch, total = time.time(), len(history), 0.0
        net.train()
        as_is = [fused or not config.degrade for fused in data.fused]
        source = draw_batches(data.samples, as_is, data.weights, config.batch, steps,
                         (config.seed, epoch), config.blind)
        for x, y in tqdm(source, total=steps, desc=f"{path.stem} epoch {epoch}", mininterval=30):
            with torch.autocast("cpu", torch.bfloat16):
                loss = net.loss(x.to(memory_format=torch.channels_last), y,
                                likelihood=config.likelihood, shape_weight=config.form_weight)
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 5.0)
            optimizer.step()
            schedule.step()
            average.update_parameters(net)
            total += float(loss.detach())
        line = {"epoch": epoch, "loss": total / steps, **measure_held_out(average.module, held),
                "seconds": time.time() - begin}
        history.append(line)
        print(path.stem, json.dumps({k: round(v, 4) for k, v in line.items()}), flush=True)
        if line["score"] <= min(h["score"] for h in history):
            best = {name: value.clone() for name, value in average.module.state_dict().items()}
        _write_checkpoint(path, {**{name: part.state_dict() for name, part in parts.items()},
                      "history": history, "best": best, "config": asdict(config),
                      "encoder": "own" if isinstance(net, GammaNet) else "dinov2"})


def _makes_progress(history: list[dict], patience: int) -> bool:
    scores = [line["score"] for line in history]
    return not scores or len(scores) - 1 - int(np.argmin(scores)) < patience


def measure_held_out(
    net: torch.nn.Module, held: TrainingData, blind: float = 0.0
) -> dict[str, float]:
    """Errors on families left out: `score` is the mean error of log gamma."""
    order = np.random.default_rng(0).permutation(len(held.samples))[:_WATCHED]
    x = np.stack([make_input(held.samples[i], held.fused[i], (7, int(i)), blind)
                  for i in order])
    true = target_tensor([held.samples[i] for i in order])[:, 0]
    net.eval()
    with torch.no_grad():
        mean = torch.cat([net(part)[0] for part in torch.from_numpy(x).split(64)])
    gamma, guess = torch.exp(true), torch.exp(mean)
    fused = torch.tensor([held.fused[i] for i in order])
    of_fused = float((guess - gamma)[fused].abs().mean()) if fused.any() else 0.0
    return {"score": float((mean - true).abs().mean()), "mae": float((guess - gamma).abs().mean()),
            "r2": float(1 - ((guess - gamma) ** 2).mean() / gamma.var(correction=0)),
            "bias": float((guess - gamma).mean()), "mae_fused": of_fused}


def _write_checkpoint(path: Path, state: dict) -> None:
    half = path.with_suffix(".part")
    torch.save(state, half)
    half.replace(path)


def read_member(path: Path, encoder_folder: Path | None = None) -> tuple[nn.Module, list[dict]]:
    """The best network of a checkpoint, and its history."""
    state = torch.load(path, weights_only=True)
    net = make_net(state["encoder"], encoder_folder)
    net.load_state_dict(state["best"])
    return net.eval(), state["history"]


def plot_curves(folder: Path) -> None:
    """Writes `curves.png`: loss and the error on families left out, a line a member."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.2))
    for path in sorted(folder.glob("member_*.pt")):
        history = torch.load(path, weights_only=True)["history"]
        axes[0].plot([h["loss"] for h in history], label=path.stem)
        axes[1].plot([h["mae"] for h in history], label=path.stem)
    for axis, title in zip(axes, ("training loss", "gamma MAE, families left out")):
        axis.set_xlabel("epoch")
        axis.set_title(title)
    axes[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(folder / "curves.png", dpi=90)
    pyplot.close(figure)
