# SPDX-License-Identifier: Apache-2.0
"""One network of the ensemble: how it learns, resumes, and is evaluated on families left out."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import make_net
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.occupancy.known_form import hide_above
from stack_counter.tasks.progress import progress
from stack_counter.train.data.batches import (
    SETTINGS,
    Batch,
    NetworkInput,
    draw_batches,
    make_input,
    target_tensor,
)
from stack_counter.train.data.heights import Sample
from stack_counter.train.device import mixed_precision, training_device
from stack_counter.types import KnownLevel


@dataclass(frozen=True)
class TrainConfig:
    """How to learn, stored with the checkpoint; all chosen.

    Attributes:
        epochs: passes; an epoch draws as many samples as there are.
        batch: tiles.
        rate: highest learning rate of the one cycle.
        decay: weight decay.
        patience: epochs without progress on the families left out after which training stops.
        seed: of weights, batches and augmentation.
        likelihood: Laplace's likelihood, not the squared error, of log gamma.
        form_weight: weight of the error of the part's shape; docs/gamma.md compares it with 0.
        blind: share of tiles without wall and floor.
        pictures: share of cast surfaces that are degraded as stereo on pictures does.
        degrade: degrade surfaces as fusion does; else they are learnt from as cast.
        averaging: decay of the moving average of the weights, which is what is kept.
        gradient_limit: largest norm of a gradient.
        warmup: share of the cycle in which the rate rises.
        fused_weight: how often a fused scan is drawn, a cast surface being drawn once.
        evaluated: samples of families left out on which an epoch is evaluated.
        family_exponent: a sample is drawn by the size of its group of families to the power of
            minus this: 0 draws all samples alike, 1 all groups.
    """

    epochs: int = 20
    batch: int = 32
    rate: float = 2e-3
    decay: float = 0.05
    patience: int = 10
    seed: int = 0
    likelihood: bool = True
    form_weight: float = 0.02
    blind: float = SETTINGS.blind_share
    pictures: float = SETTINGS.picture_share
    degrade: bool = True
    averaging: float = 0.995
    gradient_limit: float = 5.0
    warmup: float = 0.2
    fused_weight: float = 3.0
    evaluated: int = 400
    family_exponent: float = 0.75


@dataclass(frozen=True, eq=False)
class TrainingData:
    """Samples to learn from.

    Attributes:
        samples: cast and fused ones.
        fused: for each whether it was truly fused.
        weights: (n,) how often each is drawn, relatively.
    """

    samples: list[Sample]
    fused: list[bool]
    weights: np.ndarray

    @property
    def families(self) -> list[str]:
        """Names of the families, sorted."""
        return sorted({s.family for s in self.samples})

    def select(self, chosen: np.ndarray) -> TrainingData:
        """Returns the samples that a (n,) bool mask chooses."""
        rows = np.flatnonzero(chosen)
        return TrainingData([self.samples[i] for i in rows], [self.fused[i] for i in rows],
                            self.weights[rows])


class Training:
    """State of one network's training, all of which a checkpoint holds."""

    def __init__(self, net: nn.Module, config: TrainConfig, steps: int):
        """`steps`: batches of an epoch."""
        self.device = training_device()
        self.net = net.to(self.device, memory_format=torch.channels_last)
        self.average = AveragedModel(self.net, use_buffers=True,
                                     multi_avg_fn=get_ema_multi_avg_fn(config.averaging))
        self.optimizer = torch.optim.AdamW(self.net.parameters(), config.rate,
                                           weight_decay=config.decay)
        total = config.epochs * steps + 1
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(  # of few steps one is a warm-up, too
            self.optimizer, config.rate, total, pct_start=max(config.warmup, 1.5 / total))
        self.history: list[dict[str, Any]] = []
        self.best: dict[str, torch.Tensor] = {}
        self._config = config

    def load(self, path: Path) -> None:
        """Goes on from a checkpoint.

        Raises:
            ConfigError: it is of a network of another architecture.
        """
        state = read_checkpoint(path)
        settings = state.get("net_config", {})
        if settings != _settings_of(self.net):
            raise ConfigError(f"{path} is of a network {settings}; expected "
                              f"{_settings_of(self.net)}: name another --out")
        for name, part in self._parts().items():
            part.load_state_dict(state[name])
        self.history, self.best = state["history"], state["best"]

    def save(self, path: Path) -> None:
        """Writes a checkpoint in one step."""
        state = {**{name: part.state_dict() for name, part in self._parts().items()},
                 "history": self.history, "best": self.best, "config": asdict(self._config),
                 "encoder": "own" if isinstance(self.net, GammaNet) else "dinov2",
                 "net_config": _settings_of(self.net)}
        unfinished = path.with_suffix(".part")
        torch.save(state, unfinished)
        unfinished.replace(path)

    def step(self, batch: Batch) -> torch.Tensor:
        """Learns one batch and returns its loss, for which nobody has waited yet."""
        x, known, resolution, y = (part.to(self.device, non_blocking=True) for part in batch)
        with mixed_precision(self.device):
            loss = self.net.loss(x.to(memory_format=torch.channels_last), y,
                                 likelihood=self._config.likelihood,
                                 shape_weight=self._config.form_weight, known=known,
                                 resolution=resolution)
        self.descend(loss)
        return loss.detach()

    def descend(self, loss: torch.Tensor) -> None:
        """Changes the weights so that the loss falls, and their average."""
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), self._config.gradient_limit)
        self.optimizer.step()
        self.schedule.step()
        self.average.update_parameters(self.net)

    def is_finished(self) -> bool:
        """Whether all epochs are done, or the last ones brought no progress."""
        scores = [line["score"] for line in self.history]
        return len(scores) >= self._config.epochs or bool(
            scores and len(scores) - 1 - int(np.argmin(scores)) >= self._config.patience)

    def end_epoch(self, line: dict[str, Any]) -> None:
        """Appends an epoch's figures; keeps the averaged weights if they are the best so far."""
        self.history.append(line)
        if line["score"] <= min(earlier["score"] for earlier in self.history):
            weights = self.average.module.state_dict()
            self.best = {name: value.clone() for name, value in weights.items()}

    def _parts(self) -> dict[str, Any]:
        return {"net": self.net, "average": self.average, "optimizer": self.optimizer,
                "schedule": self.schedule}


def _settings_of(net: nn.Module) -> dict[str, Any]:
    """Settings of the architecture; none of the paper's network, whose encoder is the user's."""
    settings = getattr(net, "config", None)
    return asdict(settings) if is_dataclass(settings) else {}


def train_member(net: nn.Module, data: TrainingData, held_out: TrainingData, config: TrainConfig,
                 path: Path, cores: int = 1) -> None:
    """Trains one network, from its checkpoint if there is one; the best epoch is kept.

    Where torch finds an accelerator, the network learns there, from batches that other processes
    prepare.

    Args:
        net: untrained.
        data: what is learnt.
        held_out: samples of families left out, on which every epoch is evaluated.
        config: how to learn.
        path: checkpoint.
        cores: number of processes that prepare batches for an accelerator.
    """
    steps = max(len(data.samples) // config.batch, 1)
    training = Training(net, config, steps)
    if path.exists():
        training.load(path)
    as_is = [fused or not config.degrade for fused in data.fused]
    while not training.is_finished():
        begin, epoch = time.time(), len(training.history)
        # Learn an epoch's batches.
        net.train()
        batches = draw_batches(data.samples, as_is, data.weights, config.batch, steps,
                               (config.seed, epoch), config.blind, config.pictures,
                               0 if training.device.type == "cpu" else cores)
        losses = [training.step(batch) for batch in
                  progress(batches, f"{path.stem} epoch {epoch}", "steps", steps)]
        # Evaluate the averaged weights and store all.
        line = {"epoch": epoch, "loss": sum(map(float, losses)) / steps,
                **measure_held_out(training.average.module, held_out),
                "seconds": time.time() - begin}
        print(path.stem, json.dumps({k: round(v, 4) for k, v in line.items()}), flush=True)
        training.end_epoch(line)
        training.save(path)


def measure_held_out(net: nn.Module, held_out: TrainingData, blind_share: float = 0.0
                      ) -> dict[str, float]:
    """Measures errors on families left out; `score` is the mean error of log gamma.

    `nae` is the normalised absolute error of the count that they alone bring about, V being true.
    Of a network that knows the form it is the mean over the levels of knowledge; the other figures
    are with v alone known, and `mae_size` and `mae_mesh` with more. Of one that knows the
    resolution it is over surfaces as stereo on pictures shows them too, see `mae_pictures`.
    """
    # The same tiles in every epoch.
    rows = np.random.default_rng(0).permutation(len(held_out.samples))[:TrainConfig.evaluated]
    inputs = [make_input(held_out.samples[i], held_out.fused[i], (7, int(i)), blind_share)
              for i in rows]
    known = np.stack([held_out.samples[i].known for i in rows])
    log_true = target_tensor([held_out.samples[i] for i in rows])[:, 0]
    true = torch.exp(log_true)
    # Predict at each level of knowledge that makes a difference, and from pictures.
    levels = list(KnownLevel) if isinstance(net, GammaNet) and net.config.knows_form \
        else [KnownLevel.VOLUME]
    by_level = [_predict(net, inputs, hide_above(known, level)) for level in levels]
    log_errors = [float((p - log_true).abs().mean()) for p in by_level]
    cast = np.array([not held_out.fused[i] and held_out.samples[i].seen_by is not None
                     for i in rows])
    of_pictures = {}
    if isinstance(net, GammaNet) and net.config.knows_resolution and cast.any():
        pictures = [make_input(held_out.samples[i], False, (7, int(i)), blind_share, 1.0)
                    for i in rows[cast]]
        predicted = _predict(net, pictures, hide_above(known[cast], KnownLevel.VOLUME))
        log_errors.append(float((predicted - log_true[cast]).abs().mean()))
        of_pictures = {"mae_pictures": float((torch.exp(predicted) - true[cast]).abs().mean())}
    # Compare.
    gamma = torch.exp(by_level[0])
    fused = torch.tensor([held_out.fused[i] for i in rows])
    mae_fused = float((gamma - true)[fused].abs().mean()) if fused.any() else 0.0
    count = torch.tensor([float(held_out.samples[i].count) for i in rows])
    nae = float((count * (gamma / true - 1)).abs().sum() / count.sum())
    return {"score": float(np.mean(log_errors)),
            "mae": float((gamma - true).abs().mean()),
            "r2": float(1 - ((gamma - true) ** 2).mean() / true.var(correction=0)),
            "bias": float((gamma - true).mean()), "mae_fused": mae_fused, "nae": nae,
            **{f"mae_{level.name.lower()}": float((torch.exp(p) - true).abs().mean())
               for level, p in zip(levels[1:], by_level[1:])}, **of_pictures}


def _predict(net: nn.Module, inputs: list[NetworkInput], known: np.ndarray) -> torch.Tensor:
    """(n,) log gamma of n inputs and (n, KNOWN_VALUES), on the CPU."""
    net.eval()
    device = next(net.parameters()).device
    x, resolution = (torch.from_numpy(np.stack(part)) for part in zip(*inputs))
    parts = zip(x.split(64), torch.from_numpy(known).split(64), resolution.split(64))
    with torch.no_grad():
        return torch.cat([net(*(a.to(device) for a in part))[0].cpu() for part in parts])


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Reads what a member's training has written, wherever it was trained, to the CPU."""
    state: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
    return state


def read_member(path: Path, encoder_folder: Path | None = None
                ) -> tuple[nn.Module, list[dict[str, Any]]]:
    """Reads the best network of a checkpoint, and its history."""
    state = read_checkpoint(path)
    net = GammaNet(NetConfig(**state.get("net_config", {}))) if state["encoder"] == "own" \
        else make_net(state["encoder"], encoder_folder)
    net.load_state_dict(state["best"])
    return net.eval(), state["history"]
