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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from stack_counter.container.wall_network import (
    WallNet,
    outer_width,
    save_wall_net,
    wall_crop,
)
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.errors import ConfigError, ViewError
from stack_counter.sim import Scene, read_shard, record
from stack_counter.types import WallShape


@dataclass(frozen=True)
class WallTrainingSettings:
    """How Psi learns; chosen.

    Attributes:
        views: views of a scene.
        epochs: passes over the crops.
        batch: crops of a batch.
        rate: highest learning rate.
        held_out: one of so many scenes is left out.
        outline_m: standard deviation of a fitted outline's place and size, metres.
    """

    views: int = 3
    epochs: int = 14
    batch: int = 32
    rate: float = 2e-3
    held_out: int = 5
    outline_m: float = 0.0007


SETTINGS = WallTrainingSettings()

def noisy_outline(scene: Scene, random: np.random.Generator, std: float = SETTINGS.outline_m
               ) -> WallShape | None:
    """Returns a container's outer face as its rim shows it; None for bags and heaps."""
    box = scene.container
    T, wall = box.T_world_container, box.wall_thickness_m
    x, y = T[:2, 3] + random.normal(0, std, 2)
    width, length = np.array(box.inner_size_m[:2]) + 2 * wall + random.normal(0, std, 2)
    if box.kind in ("bin", "tray"):
        return BoxWall(np.array([x, y, np.arctan2(T[1, 0], T[0, 0]), width, length, 0.0]))
    if box.kind in ("cylinder", "bowl", "cup"):
        return RoundWall(np.array([x, y, width / 2, 0.0, 0.0]))
    return None


def render_crops(scene: Scene) -> list[np.ndarray]:
    """Renders the crops of a few noisy views."""
    random = np.random.default_rng([scene.seed, scene.index, 0x3A1])
    form = noisy_outline(scene, random)
    if form is None:
        return []
    out = []
    for view in record(scene, SETTINGS.views, seed=1, color=False):
        try:
            out.append(wall_crop(view, form, scene.container.rim_height_m, 0.0))
        except ViewError:
            continue
    return out


def _cache_crops(job: tuple[Path, int, Path]) -> None:
    path, step, out = job
    crops, target, index = [], [], []
    for scene in read_shard(path):
        if scene.index % step:
            continue
        form = noisy_outline(scene, np.random.default_rng(0), 0.0)
        for crop in render_crops(scene):
            assert form is not None  # for the type checker: it has crops
            crops.append(crop.astype(np.float16))
            target.append(np.log(scene.container.wall_thickness_m / outer_width(form)))
            index.append(zlib.crc32(f"{scene.seed}:{scene.index}".encode()))
    if crops:
        np.savez_compressed(out, crops=np.stack(crops), target=target, scene=index)


def load_crops(texts: list[str], cache: Path, workers: int
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Crops, targets and scene numbers of folders `DIR:STEP`; kept below `cache`."""
    cache.mkdir(parents=True, exist_ok=True)
    jobs = []
    for text in texts:
        folder, _, step = text.partition(":")
        jobs += [(path, int(step or 1), cache / f"{path.parent.name}_{path.stem}_{step}.npz")
                 for path in sorted(Path(folder).glob("shard_*.npz"))]
    if not jobs:
        raise ConfigError(f"no shard_*.npz in {texts}; expected folders of scenes")
    missing = [job for job in jobs if not job[2].exists()]
    if missing:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for _ in tqdm(pool.map(_cache_crops, missing), total=len(missing), unit=" shards"):
                pass
    parts = [np.load(out) for _, _, out in jobs if out.exists()]
    crops, target, scene = (np.concatenate([p[name] for p in parts])
                            for name in ("crops", "target", "scene"))
    return crops, target.astype(np.float32), scene


def train_wall_net(
    crops: np.ndarray, target: np.ndarray, seed: int = 0, batch: int = SETTINGS.batch
) -> WallNet:
    """One network, by the one-cycle rule; mirrored at random."""
    torch.manual_seed(seed)
    random, net = np.random.default_rng(seed), WallNet()
    steps = max(len(crops) // batch, 1)
    optimizer = torch.optim.AdamW(net.parameters(), SETTINGS.rate, weight_decay=0.02)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, SETTINGS.rate, SETTINGS.epochs * steps + 1
    )
    net.train()
    for _ in tqdm(range(SETTINGS.epochs), unit=" epochs"):
        order = random.permutation(len(crops))[:steps * batch]
        for rows in order.reshape(steps, -1) if len(order) >= batch else order[None]:
            x = torch.from_numpy(crops[rows].astype(np.float32))
            x = x.flip(3) if random.random() < 0.5 else x
            with torch.autocast("cpu", torch.bfloat16):
                loss = net.loss(x, torch.from_numpy(target[rows]))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return net.eval()


def main() -> int:
    """Trains on four of five scenes, prints the errors on the fifth, writes the weights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", metavar="DIR[:STEP]")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cache", type=Path, default=Path("out/walls"))
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    crops, target, scene = load_crops(options.scenes, options.cache, options.workers)
    held = scene % SETTINGS.held_out == 0
    net = train_wall_net(crops[~held], target[~held])
    with torch.inference_mode():
        guess = np.concatenate([net(x.float())[0].numpy()
                                for x in torch.from_numpy(crops[held]).split(64)])
    by_scene = [(np.exp(guess[scene[held] == s]).mean(), np.exp(target[held][scene[held] == s][0]))
                for s in np.unique(scene[held])]
    got, true = np.array(by_scene).T
    errors = {"scenes": len(true), "mean_abs_share_of_width": float(np.abs(got - true).mean()),
              "median_relative": float(np.median(np.abs(got / true - 1))),
              "of_the_mean": float(np.abs(true.mean() - true).mean())}
    save_wall_net(options.out, net, {"errors": json.dumps(errors)})
    print(json.dumps(errors, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
