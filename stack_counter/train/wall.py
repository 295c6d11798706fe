# SPDX-License-Identifier: Apache-2.0
"""Trains Psi, the wall-thickness network, on noisy views of simulated containers.

    python -m stack_counter.train.wall data/train-deep data/train-shallow --out wall.safetensors

The outer outline is the true one, moved and stretched as a fitted one may be.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from stack_counter.container.wall_network import outer_width, wall_crop
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.errors import ConfigError, ViewError
from stack_counter.sim import Scene, read_shard, record
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.tasks.progress import progress
from stack_counter.train.device import mixed_precision
from stack_counter.train.wall_net import WallNet, save_wall_net
from stack_counter.types import WallShape


@dataclass(frozen=True)
class WallTrainingSettings:
    """What is learnt from, and how; all chosen.

    Attributes:
        views: views of a scene.
        outline_std_m: standard deviation of a fitted outline's place and size, metres.
        held_out_step: of so many scenes one is left out.
        epochs: passes over the crops.
        batch: crops of a batch.
        rate: highest learning rate of the one cycle.
        decay: weight decay.
    """

    views: int = 3
    outline_std_m: float = 0.0007
    held_out_step: int = 5
    epochs: int = 14
    batch: int = 32
    rate: float = 2e-3
    decay: float = 0.02


SETTINGS = WallTrainingSettings()


@dataclass(frozen=True, eq=False)
class WallCrops:
    """Network inputs with their truth.

    Attributes:
        crops: (n, ...) float16 inputs, as `wall_crop` makes them.
        targets: (n,) float32 log of the wall's thickness over the container's width.
        scenes: (n,) number that tells the scene of each.
    """

    crops: np.ndarray
    targets: np.ndarray
    scenes: np.ndarray


def noisy_outline(scene: Scene, random: np.random.Generator,
                  std: float = SETTINGS.outline_std_m) -> WallShape | None:
    """Makes the outer face of a scene's container as its rim shows it; None for bags and heaps.

    Args:
        scene: with the container.
        random: draws the errors of place and size.
        std: their standard deviation, metres.
    """
    container = scene.container
    T, thickness = container.T_world_container, container.wall_thickness_m
    x, y = T[:2, 3] + random.normal(0, std, 2)
    width, length = np.array(container.inner_size_m[:2]) + 2 * thickness + random.normal(0, std, 2)
    if container.kind in ("bin", "tray"):
        return BoxWall(np.array([x, y, np.arctan2(T[1, 0], T[0, 0]), width, length, 0.0]))
    if container.kind in ("cylinder", "bowl", "cup"):
        return RoundWall(np.array([x, y, width / 2, 0.0, 0.0]))
    return None


def render_crops(scene: Scene) -> list[np.ndarray]:
    """Crops the walls out of a few noisy views of a scene."""
    random = np.random.default_rng([scene.seed, scene.index, 0x3A1])
    shape = noisy_outline(scene, random)
    if shape is None:
        return []
    crops = []
    for view in record(scene, SETTINGS.views, seed=1, color=False):
        try:
            crops.append(wall_crop(view, shape, scene.container.rim_height_m, 0.0))
        except ViewError:
            continue
    return crops


def load_crops(folders: list[str], cache: Path, workers: int) -> WallCrops:
    """Loads the crops of folders `DIR:STEP`; each shard's are made once and stored below `cache`.

    Raises:
        ConfigError: no folder holds shards of scenes.
    """
    cache.mkdir(parents=True, exist_ok=True)
    jobs = []
    for text in folders:
        folder, _, step = text.partition(":")
        jobs += [(path, int(step or 1), cache / f"{path.parent.name}_{path.stem}_{step}.npz")
                 for path in sorted(Path(folder).glob("shard_*.npz"))]
    if not jobs:
        raise ConfigError(f"no shard_*.npz in {folders}; expected folders of scenes")
    missing = [job for job in jobs if not job[2].exists()]
    if missing:
        with worker_pool(workers) as pool:
            for _ in progress(pool.map(_store_crops, missing), "crops", "shards", len(missing)):
                pass
    stored = [np.load(path) for _, _, path in jobs if path.exists()]
    crops, targets, scenes = (np.concatenate([file[name] for file in stored])
                              for name in ("crops", "target", "scene"))
    return WallCrops(crops, targets.astype(np.float32), scenes)


def train_wall_net(crops: np.ndarray, targets: np.ndarray, seed: int = 0,
                   batch: int = SETTINGS.batch) -> WallNet:
    """Trains one network by the one-cycle rule; crops are mirrored at random.

    Args:
        crops: (n, ...) inputs.
        targets: (n,) float32.
        seed: of weights, order and mirroring.
        batch: crops of a batch.
    """
    torch.manual_seed(seed)
    random, net = np.random.default_rng(seed), WallNet()
    steps = max(len(crops) // batch, 1)
    optimizer = torch.optim.AdamW(net.parameters(), SETTINGS.rate, weight_decay=SETTINGS.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, SETTINGS.rate,
                                                   SETTINGS.epochs * steps + 1)
    net.train()
    for _ in progress(range(SETTINGS.epochs), "training", "epochs"):
        order = random.permutation(len(crops))[:steps * batch]
        for rows in order.reshape(steps, -1) if len(order) >= batch else order[None]:
            x = torch.from_numpy(crops[rows].astype(np.float32))
            x = x.flip(3) if random.random() < 0.5 else x
            with mixed_precision(torch.device("cpu")):
                loss = net.loss(x, torch.from_numpy(targets[rows]))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return net.eval()


def evaluate_wall_net(net: WallNet, data: WallCrops) -> dict[str, float]:
    """Errors of the thickness, averaged over the views of a scene."""
    with torch.inference_mode():
        log_shares = np.concatenate([net(x.float())[0].numpy()
                                     for x in torch.from_numpy(data.crops).split(64)])
    by_scene = [(np.exp(log_shares[data.scenes == scene]).mean(),
                 np.exp(data.targets[data.scenes == scene][0]))
                for scene in np.unique(data.scenes)]
    estimated, true = np.array(by_scene).T
    return {"scenes": len(true), "mean_abs_share_of_width": float(np.abs(estimated - true).mean()),
            "median_relative": float(np.median(np.abs(estimated / true - 1))),
            "of_the_mean": float(np.abs(true.mean() - true).mean())}


def main() -> int:
    """Trains on four of five scenes, prints the errors on the fifth, writes the weights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", metavar="DIR[:STEP]")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cache", type=Path, default=Path("out/walls"))
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    data = load_crops(options.scenes, options.cache, options.workers)
    held_out = data.scenes % SETTINGS.held_out_step == 0
    net = train_wall_net(data.crops[~held_out], data.targets[~held_out])
    errors = evaluate_wall_net(net, WallCrops(data.crops[held_out], data.targets[held_out],
                                              data.scenes[held_out]))
    save_wall_net(options.out, net, {"errors": json.dumps(errors)})
    print(json.dumps(errors, indent=2))
    return 0


def _store_crops(job: tuple[Path, int, Path]) -> None:
    """Crops every `step`-th scene of a shard and writes crops and truth to the second path."""
    path, step, stored = job
    crops, targets, scenes = [], [], []
    for scene in read_shard(path):
        if scene.index % step:
            continue
        true_shape = noisy_outline(scene, np.random.default_rng(0), 0.0)
        for crop in render_crops(scene):
            assert true_shape is not None  # for the type checker: it has crops
            crops.append(crop.astype(np.float16))
            targets.append(np.log(scene.container.wall_thickness_m / outer_width(true_shape)))
            scenes.append(zlib.crc32(f"{scene.seed}:{scene.index}".encode()))
    if crops:
        np.savez_compressed(stored, crops=np.stack(crops), target=targets, scene=scenes)


if __name__ == "__main__":
    sys.exit(main())
