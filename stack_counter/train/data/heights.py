# SPDX-License-Identifier: Apache-2.0
"""Height maps of simulated scenes as the network's maps: cast, seen by an arc of views, stored.

Rays straight down give the ideal surface. What no view of a typical arc can see is then hidden and
filled in by the run time's own rule. Noise and blur are drawn anew each time a scene is learnt
from: `train.data.degrade` for depth cameras, `train.data.stereo_surface` for pictures.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from stack_counter.errors import ConfigError
from stack_counter.occupancy.known_form import KNOWN_VALUES, form_of_mesh, known_values
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, StackMaps, make_maps
from stack_counter.reconstruction.integral import fill_unknown_cells
from stack_counter.sim import Scene, ideal_surface, read_shard
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.tasks.progress import progress

# Format of the stored samples.
_STEPS_PER_LENGTH = 500  # a part length
_LARGEST_HEIGHT = 65  # part lengths that 16 bits hold
_CACHE_VERSION = "heights 6"


@dataclass(frozen=True)
class ArcSettings:
    """The arc of views from which the training surfaces are seen.

    It is that of `sim.record`; the numbers that are not laid down there are chosen.

    Attributes:
        views: number of views, at equal angles around the stack.
        tilts_deg: tilts from the vertical, in turn.
        tilt_spread_deg: largest deviation from them: of the arc, and of perspective across the
            stack.
        border_px: pixels around the opening in which the rim hides what lies below it.
        clearance: part lengths that a ray may pass below a surface and still be free.
    """

    views: int = 12
    tilts_deg: tuple[float, ...] = (12, 28, 42)
    tilt_spread_deg: float = 7.0
    border_px: int = 6
    clearance: float = 0.01


SETTINGS = ArcSettings()


@dataclass(frozen=True, eq=False)
class Sample:
    """One scene's maps and truth.

    Attributes:
        maps: of the surface that an arc of views sees.
        gamma: true occupancy ratio.
        shape_logs: (3,) float32 logs of part size, convexity and surface, in part lengths.
        part_length_m: v**(1/3), metres.
        name: `seed:index` of the scene.
        family: of the part's shape.
        container_kind: as the simulator names it; `none` for a heap.
        count: parts in the scene.
        fill: share of the container that was to be filled.
        known: (KNOWN_VALUES,) float32 of `known_form.known_values`, the mesh being known.
        seen_by: (rows, cols) uint8, how many views of the arc see each cell; None if not cast.
        resolution_m: length that a reconstructed surface resolves, metres; 0 if cast.
        from_pictures: it was reconstructed from pictures without depth.
    """

    maps: StackMaps
    gamma: float
    shape_logs: np.ndarray
    part_length_m: float
    name: str
    family: str
    container_kind: str
    count: int
    fill: float
    known: np.ndarray = field(default_factory=lambda: np.zeros(KNOWN_VALUES, np.float32))
    seen_by: np.ndarray | None = None
    resolution_m: float = 0.0
    from_pictures: bool = False

    @property
    def seen_share(self) -> np.ndarray:
        """(rows, cols) float32 share of the arc's views that see each cell."""
        assert self.seen_by is not None  # only surfaces that were cast are degraded
        return (self.seen_by / SETTINGS.views).astype(np.float32)


def make_sample(scene: Scene) -> Sample:
    """Makes the sample of a scene as an arc of views sees it."""
    surface = ideal_surface(scene)
    top, valid = surface.top, surface.valid
    part_length = scene.truth.unit_volume ** (1 / 3)
    # Hide what no view sees, and fill it in as the run time does.
    random = np.random.default_rng([scene.seed, scene.index, 0x5EE])
    seen_by = count_views_of_cells(top, valid, scene.container.rim_height_m / part_length, random)
    seen = seen_by > 0
    if seen.any():
        top = fill_unknown_cells(np.where(seen, top, np.nan), seen)
        top = np.where(valid, top, 0).astype(np.float32)
    maps = make_maps(top, surface.inner, valid, walled=scene.container.kind != "none")
    return replace(label_maps(maps, scene), seen_by=seen_by)


def label_maps(maps: StackMaps, scene: Scene) -> Sample:
    """Joins maps of a scene, however they were made, with its truth."""
    shape, unit_volume = scene.shape, scene.truth.unit_volume
    known = known_values(form_of_mesh(shape.vertices, shape.faces), unit_volume)
    return Sample(maps, scene.truth.gamma, shape_logs(scene), unit_volume ** (1 / 3),
                  f"{scene.seed}:{scene.index}", shape.family, scene.container.kind,
                  scene.truth.count, scene.truth.fill, known)


def shape_logs(scene: Scene) -> np.ndarray:
    """(3,) float32 logs of part size, convexity and surface, in part lengths."""
    shape, part_length = scene.shape, scene.truth.unit_volume ** (1 / 3)
    return np.log([shape.part_size / part_length, shape.convexity,
                   float(shape.mesh.area) / part_length**2]).astype(np.float32)


def count_views_of_cells(top: np.ndarray, valid: np.ndarray, rim: float,
                         random: np.random.Generator) -> np.ndarray:
    """Marches rays from every cell to the views of an arc over the surface.

    Args:
        top: (rows, cols) heights, part lengths.
        valid: (rows, cols) bool, over the opening.
        rim: height of the rim around it, part lengths.
        random: draws where the arc begins and how its views tilt.

    Returns:
        (rows, cols) uint8: how many views of the arc see each cell; 0 where not valid.
    """
    border = SETTINGS.border_px
    surroundings = np.pad(np.where(valid, top, rim), border, constant_values=rim)
    relief = float(surroundings.max() - surroundings.min())
    first_angle = random.uniform(0, 2 * np.pi)
    seen_by = np.zeros(top.shape, np.uint8)
    for i in range(SETTINGS.views):
        # Direction to the view, and how much a ray rises with each pixel.
        spread = SETTINGS.tilt_spread_deg
        tilt = np.deg2rad(SETTINGS.tilts_deg[i % len(SETTINGS.tilts_deg)]
                          + random.uniform(-spread, spread))
        angle = first_angle + 2 * np.pi * i / SETTINGS.views
        rise = 1 / np.tan(max(tilt, 0.02)) / PIXELS_PER_LENGTH
        # A cell is blocked where the surface stands above its ray.
        blocked = np.zeros(top.shape, bool)
        for step in range(1, min(int(relief / rise) + 1, 4 * PIXELS_PER_LENGTH)):
            dy, dx = (int(round(step * f)) for f in (np.sin(angle), np.cos(angle)))
            blocked |= _shift(surroundings, dy, dx, top.shape) \
                > top + step * rise + SETTINGS.clearance
        seen_by += ~blocked
    return seen_by * valid


def load_samples(folders: list[Path], cache: Path, workers: int) -> list[Sample]:
    """Loads all scenes with parts in them; a shard is cast once and stored below `cache`."""
    paths = [path for folder in folders for path in sorted(folder.glob("shard_*.npz"))]
    jobs = [(path, cache / f"{path.parent.name}_{path.stem}_{_shard_digest(path)}.npz")
            for path in paths]
    cache.mkdir(parents=True, exist_ok=True)
    store_missing(jobs, _store_shard, "height maps", workers)
    return [sample for _, stored in jobs for sample in read_samples(stored)]


def store_missing(jobs: list[tuple[Path, Path]], store: Callable[[tuple[Path, Path]], None],
                  title: str, workers: int) -> None:
    """Has `store` make, by worker processes, the second file of each pair that is not there yet.

    Args:
        jobs: pairs of a shard and what is made of it.
        store: a function of a module.
        title: of the progress.
        workers: number of processes.
    """
    missing = [job for job in jobs if not job[1].exists()]
    if missing:
        with worker_pool(workers) as pool:
            for _ in progress(pool.map(store, missing), title, "shards", len(missing)):
                pass


def write_samples(path: Path, samples: list[Sample], **more: np.ndarray) -> None:
    """Writes samples in one step, beside arrays of the caller's."""
    def encode(heights: np.ndarray) -> np.ndarray:
        limited = np.clip(heights, -_LARGEST_HEIGHT, _LARGEST_HEIGHT)
        return np.round(limited * _STEPS_PER_LENGTH).astype(np.int16)

    arrays = {f"{i}_{name}": value for i, s in enumerate(samples) for name, value in (
        ("top", encode(s.maps.top)), ("height", encode(s.maps.height)),
        ("valid", np.packbits(s.maps.valid)), ("seen_by", s.seen_by)) if value is not None}
    facts = np.array([(s.gamma, *s.shape_logs, s.part_length_m, s.count, s.fill,
                       s.container_kind != "none") for s in samples], np.float64)
    unfinished = path.with_suffix(".part")
    with open(unfinished, "wb") as file:
        np.savez_compressed(file, **arrays, **more, facts=facts, names=[s.name for s in samples],
                            families=[s.family for s in samples],
                            kinds=[s.container_kind for s in samples],
                            known=np.array([s.known for s in samples], np.float32),
                            resolution_m=[s.resolution_m for s in samples],
                            from_pictures=[s.from_pictures for s in samples])
    unfinished.replace(path)


def read_samples(path: Path) -> list[Sample]:
    """Reads the samples that `write_samples` has written.

    Raises:
        ConfigError: another version has written them.
    """
    samples = []
    with np.load(path, allow_pickle=False) as file:
        if "resolution_m" not in file:
            raise ConfigError(f"{path} is of an older version, without the surfaces' resolution; "
                              "expected none: delete it and run the command that made it again")
        facts, names, families, kinds, known, resolution_m, from_pictures = (
            file[n] for n in ("facts", "names", "families", "kinds", "known", "resolution_m",
                              "from_pictures"))
        for i, (gamma, *logs, part_length, count, fill, walled) in enumerate(facts):
            top, height = (file[f"{i}_{name}"].astype(np.float32) / _STEPS_PER_LENGTH
                           for name in ("top", "height"))
            valid = np.unpackbits(file[f"{i}_valid"], count=top.size).reshape(top.shape) > 0
            maps = make_maps(top, top - height, valid, bool(walled))
            samples.append(Sample(maps, gamma, np.array(logs, np.float32), part_length,
                                  str(names[i]), str(families[i]), str(kinds[i]), int(count),
                                  fill, known[i], file.get(f"{i}_seen_by"),
                                  float(resolution_m[i]), bool(from_pictures[i])))
    return samples


def _shift(surroundings: np.ndarray, dy: int, dx: int, shape: tuple[int, ...]) -> np.ndarray:
    """(rows, cols) heights that lie (dy, dx) pixels beside each cell; the border goes on."""
    border = SETTINGS.border_px
    rows = np.clip(np.arange(shape[0]) + dy + border, 0, surroundings.shape[0] - 1)
    cols = np.clip(np.arange(shape[1]) + dx + border, 0, surroundings.shape[1] - 1)
    return surroundings[rows[:, None], cols[None]]


def _shard_digest(path: Path) -> str:
    """Digest of a shard's bytes and of how its samples are made."""
    return f"{zlib.crc32(path.read_bytes() + _CACHE_VERSION.encode()):08x}"


def _store_shard(job: tuple[Path, Path]) -> None:
    """Casts a shard, the first path, and writes its samples to the second."""
    path, stored = job
    write_samples(stored, [make_sample(scene) for scene in read_shard(path) if scene.truth.count])
