# SPDX-License-Identifier: Apache-2.0
"""Height maps of simulated scenes as the network's maps: cast, seen by an arc of views, kept.

Rays straight down give the ideal surface. What no view of a typical arc can see is then hidden and
filled in by the run time's own rule. Noise and blur are drawn anew each time a scene is learnt
from: `train.degrade`.
"""

from __future__ import annotations

import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, StackMaps, make_maps
from stack_counter.reconstruction.integral import fill_unknown_cells
from stack_counter.sim import Scene, ideal_surface, read_shard


@dataclass(frozen=True)
class HeightSettings:
    """How ideal surfaces are seen and stored; chosen.

    Attributes:
        steps: steps of a part length in which heights are stored.
        views: views of the arc.
        tilts_deg: tilts of the views from the vertical, degrees.
        tilt_spread_deg: spread of the tilts by the arc and by perspective across the stack,
            degrees.
        outside_px: pixels around the opening in which the rim hides what lies below it.
    """

    steps: int = 500
    views: int = 12
    tilts_deg: tuple[float, ...] = (12, 28, 42)
    tilt_spread_deg: float = 7.0
    outside_px: int = 6


SETTINGS = HeightSettings()
_CACHE = "heights 3"


@dataclass(frozen=True, eq=False)
class Sample:
    """One scene's maps and truth.

    Attributes:
        maps: maps of the surface that an arc of views sees.
        gamma: true occupancy ratio.
        form: (3,) logs of the part size, the convexity and the surface, in part lengths.
        length_m: part length, metres.
        name: `seed:index` of the scene.
        family: family of the part.
        kind: kind of the container.
        count: number of parts.
        fill: share of the container's depth that is filled.
    """

    maps: StackMaps
    gamma: float
    shape_logs: np.ndarray
    length_m: float
    name: str
    family: str
    kind: str
    count: int
    fill: float


def find_cells_seen_by_arc(
    top: np.ndarray, valid: np.ndarray, rim: float, random: np.random.Generator
) -> np.ndarray:
    """Finds the cells that some view of an arc sees: (rows, cols) bool.

    Heights and `rim` are in part lengths.
    """
    around = np.pad(np.where(valid, top, rim), SETTINGS.outside_px, constant_values=rim)
    drop = float(around.max() - around.min())
    turn = random.uniform(0, 2 * np.pi)
    seen = np.zeros(top.shape, bool)
    for i in range(SETTINGS.views):
        spread = random.uniform(-SETTINGS.tilt_spread_deg, SETTINGS.tilt_spread_deg)
        tilt = np.deg2rad(SETTINGS.tilts_deg[i % 3] + spread)
        angle = turn + 2 * np.pi * i / SETTINGS.views
        rise = (
            1 / np.tan(max(tilt, 0.02)) / PIXELS_PER_LENGTH
        )  # of the ray: part lengths for each pixel
        blocked = np.zeros(top.shape, bool)
        for step in range(1, min(int(drop / rise) + 1, 4 * PIXELS_PER_LENGTH)):
            dy, dx = (int(round(step * f)) for f in (np.sin(angle), np.cos(angle)))
            blocked |= _shift_map(around, dy, dx, top.shape) > top + step * rise + 0.01
        seen |= ~blocked
    return seen & valid


def _shift_map(around: np.ndarray, dy: int, dx: int, shape: tuple[int, ...]) -> np.ndarray:
    rows = np.clip(np.arange(shape[0]) + dy + SETTINGS.outside_px, 0, around.shape[0] - 1)
    cols = np.clip(np.arange(shape[1]) + dx + SETTINGS.outside_px, 0, around.shape[1] - 1)
    return around[rows[:, None], cols[None]]


def make_sample(scene: Scene) -> Sample:
    """Makes a sample of a scene as an arc of views sees it."""
    surface = ideal_surface(scene)
    top, valid = surface.top, surface.valid
    length = scene.truth.unit_volume ** (1 / 3)
    random = np.random.default_rng([scene.seed, scene.index, 0x5EE])
    seen = find_cells_seen_by_arc(top, valid, scene.container.rim_height_m / length, random)
    if seen.any():
        top = fill_unknown_cells(np.where(seen, top, np.nan), seen)
        top = np.where(valid, top, 0).astype(np.float32)
    maps = make_maps(top, surface.inner, valid, walled=scene.container.kind != "none")
    return Sample(
        maps,
        scene.truth.gamma,
        shape_logs(scene),
        length,
        f"{scene.seed}:{scene.index}",
        scene.shape.family,
        scene.container.kind,
        scene.truth.count,
        scene.truth.fill,
    )


def shape_logs(scene: Scene) -> np.ndarray:
    """Returns the (3,) logs of part size, convexity and surface, in part lengths."""
    shape, length = scene.shape, scene.truth.unit_volume ** (1 / 3)
    return np.log([shape.part_size / length, shape.convexity,
                   float(shape.mesh.area) / length**2]).astype(np.float32)


def load_samples(folders: list[Path], cache: Path, workers: int) -> list[Sample]:
    """Loads all scenes with parts in them; each shard is cast once and kept below `cache`."""
    paths = [path for folder in folders for path in sorted(folder.glob("shard_*.npz"))]
    jobs = [(path, cache / f"{path.parent.name}_{path.stem}_{_content_key(path)}.npz")
            for path in paths]
    cache.mkdir(parents=True, exist_ok=True)
    missing = [job for job in jobs if not job[1].exists()]
    if not missing:
        return [make_sample for _, kept in jobs for make_sample in read_samples(kept)]
    # Spawned: a forked process would inherit the threads of whatever was loaded before.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for _ in tqdm(pool.map(_cache_shard, missing), total=len(missing), unit=" shards",
                      desc="height maps"):
            pass
    return [make_sample for _, kept in jobs for make_sample in read_samples(kept)]


def _content_key(path: Path) -> str:
    return f"{zlib.crc32(path.read_bytes() + _CACHE.encode()):08x}"


def _cache_shard(job: tuple[Path, Path]) -> None:
    path, out = job
    samples = [make_sample(scene) for scene in read_shard(path) if scene.truth.count]
    write_samples(out, samples)


def write_samples(out: Path, samples: list[Sample], **more: np.ndarray) -> None:
    """Writes samples as `read_samples` reads them, beside arrays of the caller's, all or none."""
    def encode_heights(heights: np.ndarray) -> np.ndarray:
        return np.round(np.clip(heights, -65, 65) * SETTINGS.steps).astype(np.int16)

    arrays = {f"{i}_{name}": value for i, s in enumerate(samples) for name, value in (
        ("top", encode_heights(s.maps.top)), ("height", encode_heights(s.maps.height)),
        ("valid", np.packbits(s.maps.valid)))}
    facts = np.array([(s.gamma, *s.shape_logs, s.length_m, s.count, s.fill, s.kind != "none")
                      for s in samples], np.float64)
    half = out.with_suffix(".part")
    with open(half, "wb") as file:
        np.savez_compressed(file, **arrays, **more, facts=facts, names=[s.name for s in samples],
                            families=[s.family for s in samples], kinds=[s.kind for s in samples])
    half.replace(out)


def read_samples(path: Path) -> list[Sample]:
    """Reads the samples of one file."""
    samples = []
    with np.load(path, allow_pickle=False) as file:
        facts, names, families, kinds = (file[n] for n in ("facts", "names", "families", "kinds"))
        for i, (gamma, *form, length, count, fill, walled) in enumerate(facts):
            top, height = (file[f"{i}_{n}"].astype(np.float32) / SETTINGS.steps
                           for n in ("top", "height"))
            valid = np.unpackbits(file[f"{i}_valid"], count=top.size).reshape(top.shape) > 0
            maps = make_maps(top, top - height, valid, bool(walled))
            samples.append(Sample(maps, gamma, np.array(form, np.float32), length, str(names[i]),
                                  str(families[i]), str(kinds[i]), int(count), fill))
    return samples
