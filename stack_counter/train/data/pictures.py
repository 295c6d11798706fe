# SPDX-License-Identifier: Apache-2.0
"""Colour key views of simulated scenes with their truth, rendered once and kept."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stack_counter.errors import ConfigError
from stack_counter.picture_baselines.picture import fit_square
from stack_counter.sim import Scene, SceneError, picture_key_view, read_shard
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks

SIDE_PX = 256  # of the squares that are kept; chosen: parts of `train-deep` take 20 pixels
_CACHE_VERSION = "pictures 1"


@dataclass(frozen=True, eq=False)
class PictureSample:
    """One scene's key view and truth.

    Attributes:
        color: (SIDE_PX, SIDE_PX, 3) uint8 RGB.
        centers: (k, 2) float32 x, y of the visible parts, pixels, those that show most first.
        boxes: (k, 4) float32 x0, y0, x1, y1 around what shows of them.
        count, gamma: of all parts.
        family: of the part's shape.
        name: `seed:index` of the scene.
    """

    color: np.ndarray
    centers: np.ndarray
    boxes: np.ndarray
    count: int
    gamma: float
    family: str
    name: str


def make_picture_sample(scene: Scene) -> PictureSample:
    """Renders the key view of a scene, about a second.

    Raises:
        SceneError: no view shows a part.
    """
    picture = picture_key_view(scene, seed=scene.index)
    square, parts = fit_square(picture.color, SIDE_PX), picture.parts
    boxes = parts.boxes(parts.visible).reshape(-1, 2, 2)
    return PictureSample(
        square.color, square.moved(parts.centers(parts.visible)).astype(np.float32),
        square.moved(boxes).reshape(-1, 4).astype(np.float32), scene.truth.count,
        scene.truth.gamma, scene.shape.family, f"{scene.seed}:{scene.index}")


def load_picture_samples(folders: list[Path], cache: Path, workers: Workers
                         ) -> list[PictureSample]:
    """Loads the samples of all scenes of folders; renders those that are not kept yet.

    Args:
        folders: of simulated scenes.
        cache: where pictures are kept, a file for each shard.
        workers: who renders.

    Raises:
        ConfigError: there is no scene.
    """
    shards = [path for folder in folders for path in sorted(folder.glob("shard_*.npz"))]
    if not shards:
        raise ConfigError(f"no scenes in {list(map(str, folders))}; expected shard_*.npz")
    cache.mkdir(parents=True, exist_ok=True)
    jobs = [(path, _cache_file(cache, path)) for path in shards]
    missing = [job for job in jobs if not job[1].exists()]
    for _ in progress(map_tasks(_render_shard, missing, workers), "pictures", "shards",
                      len(missing)):
        pass
    return [sample for _, kept in jobs for sample in _read_samples(kept)]


def _cache_file(cache: Path, shard: Path) -> Path:
    """Where a shard's pictures are kept: another content of the shard is another file."""
    digest = zlib.crc32(shard.read_bytes() + _CACHE_VERSION.encode())
    return cache / f"{shard.parent.name}_{shard.stem}_{digest:08x}.npz"


def _render_shard(job: tuple[Path, Path]) -> None:
    """Renders all scenes of a shard that show a part, and keeps them in a file."""
    shard, kept = job
    cv2.setNumThreads(1)
    samples = []
    for scene in read_shard(shard):
        try:
            samples.append(make_picture_sample(scene))
        except SceneError:
            continue  # an empty container
    unfinished = kept.with_suffix(".part")
    with unfinished.open("wb") as file:
        np.savez_compressed(
            file, color=np.array([s.color for s in samples]),
            centers=np.concatenate([np.zeros((0, 2)), *(s.centers for s in samples)]),
            boxes=np.concatenate([np.zeros((0, 4)), *(s.boxes for s in samples)]),
            visible=np.array([len(s.centers) for s in samples], int),
            count=np.array([s.count for s in samples]),
            gamma=np.array([s.gamma for s in samples]),
            family=np.array([s.family for s in samples], np.str_),
            name=np.array([s.name for s in samples], np.str_))
    unfinished.replace(kept)


def _read_samples(kept: Path) -> list[PictureSample]:
    with np.load(kept, allow_pickle=False) as file:
        ends = np.cumsum(file["visible"])[:-1]
        centers, boxes = (np.split(file[name].astype(np.float32), ends)
                          for name in ("centers", "boxes"))
        rows = zip(file["color"], centers, boxes, file["count"].tolist(), file["gamma"].tolist(),
                   file["family"].tolist(), file["name"].tolist())
        return [PictureSample(*row) for row in rows]
