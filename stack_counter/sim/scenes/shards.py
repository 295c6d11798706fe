"""Scenes in files: a shard holds consecutive scenes, packed, with their truth.

A shard is a zip of arrays with checksums, written beside its place and moved there whole. Parts
are named by family and seed and made again when it is read; those of no training family lie in
`shapes.npz` in the same folder.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import Scene, SceneError, pack, unpack
from stack_counter.sim.scenes.truth import Truth
from stack_counter.sim.shapes import FAMILIES, Shape, make_shape
from stack_counter.sim.shapes.library import load_shapes

SCENES = 50  # of a shard
LIBRARY = "shapes.npz"
_FORMAT = "stack_counter scenes 1"
_TRUTH = ("stack_volume", "fill", "gamma_whole", "gamma_center")
_SCENE = ("friction", "restitution", "taps")
_CONTAINER = ("kind", "T_world_container", "inner_size_m", "wall_thickness_m",
              "floor_thickness_m", "draft_rad", "seed")
_SAME_VOLUME = 1e-6  # relative, of a part as made again


def shard_path(folder: Path, number: int) -> Path:
    """File of scenes `number` * SCENES and following."""
    return folder / f"shard_{number:05d}.npz"


def write_shard(path: Path, scenes: list[Scene], skipped: Counter[str]) -> None:
    """Writes scenes of one seed, and how many tries failed for which reason, all or nothing.

    Raises:
        OSError: e.g. the disk is full; what was written is removed.
    """
    packed = [pack(scene.poses) for scene in scenes]
    reasons = sorted(skipped)
    arrays: dict[str, Any] = {
        "format": _FORMAT, "seed": scenes[0].seed, "index": [s.index for s in scenes],
        "family": [s.shape.family for s in scenes], "shape_seed": [s.shape.seed for s in scenes],
        "unit_volume": [s.shape.unit_volume for s in scenes],
        "count": np.array([len(s.poses) for s in scenes], np.int32),
        "frame": np.array([frame for frame, _, _ in packed]),
        "positions": np.concatenate([positions for _, positions, _ in packed]),
        "turns": np.concatenate([turns for _, _, turns in packed]),
        "skipped_reason": np.array(reasons, str), "skipped": [skipped[r] for r in reasons],
        **{f"container_{name}": [getattr(s.container, name) for s in scenes]
           for name in _CONTAINER},
        **{name: [getattr(s, name) for s in scenes] for name in _SCENE},
        **{name: [getattr(s.truth, name) for s in scenes] for name in _TRUTH}}
    half = path.with_suffix(".part")
    try:
        with open(half, "wb") as file:
            np.savez_compressed(file, **arrays)
            file.flush()
            os.fsync(file.fileno())
        os.replace(half, path)
    finally:
        half.unlink(missing_ok=True)


def read_shard(path: Path) -> list[Scene]:
    """The scenes of a file.

    Raises:
        SceneError: damaged, not a shard, or made by generators that give other parts.
    """
    data = _arrays(path)
    ends = np.cumsum(data["count"])
    library = load_shapes(path.parent / LIBRARY) if not set(data["family"]) <= set(FAMILIES) \
        else []
    shape: Shape | None = None
    scenes = []
    for i, end in enumerate(ends):
        family, seed = str(data["family"][i]), int(data["shape_seed"][i])
        v = float(data["unit_volume"][i])
        if shape is None or (shape.family, shape.seed) != (family, seed):
            shape = make_shape(seed, family) if family in FAMILIES else next(
                (part for part in library if (part.family, part.seed) == (family, seed)), None)
        if shape is None:
            raise SceneError(f"{path}: {LIBRARY} beside it lacks part {seed}, {family}")
        if abs(shape.unit_volume / v - 1) > _SAME_VOLUME:
            raise SceneError(f"{path}: {family} {seed} has {shape.unit_volume} m3; expected {v}, "
                             "as when the scene was made: another version of the generators")
        count = int(data["count"][i])
        poses = unpack(data["frame"][i], data["positions"][end - count:end],
                       data["turns"][end - count:end])
        container = ContainerShape(**{name: _plain(data[f"container_{name}"][i])
                                      for name in _CONTAINER})
        truth = Truth(count, shape.unit_volume, **{n: float(data[n][i]) for n in _TRUTH})
        scenes.append(Scene(int(data["seed"]), int(data["index"][i]), shape, container, poses,
                            **{n: data[n][i].item() for n in _SCENE}, stored_truth=truth))
    return scenes


def read_skipped(path: Path) -> Counter[str]:
    """Failed tries by reason. Raises SceneError as `read_shard`."""
    data = _arrays(path)
    return Counter(dict(zip(data["skipped_reason"].tolist(), data["skipped"].tolist())))


def read_scenes(folder: Path, most: int | None = None) -> Iterator[Scene]:
    """All scenes of a folder in order of their index, or the first `most`.

    Raises:
        SceneError: no shard there, or a damaged one.
    """
    paths = sorted(folder.glob("shard_*.npz"))
    if not paths:
        raise SceneError(f"no shard_*.npz in {folder}; expected those that simulate writes")
    given = 0
    for path in paths:
        for scene in read_shard(path):
            if given == most:
                return
            given += 1
            yield scene


def find_scene(name: str) -> Scene:
    """The scene that `DIR:INDEX` names.

    Raises:
        SceneError: not of that form, or a damaged shard.
        FileNotFoundError: no such scene.
    """
    folder, _, index = name.rpartition(":")
    if not folder or not index.isdecimal():
        raise SceneError(f"scene '{name}'; expected DIR:INDEX, e.g. data/unseen:12")
    path = shard_path(Path(folder), int(index) // SCENES)
    found = [s for s in read_shard(path) if s.index == int(index)] if path.exists() else []
    if not found:
        raise FileNotFoundError(f"no scene {index} in {folder}; expected one that simulate made "
                                "there")
    return found[0]


def _plain(value: Any) -> Any:
    """A number, text or tuple of an array's element; matrices stay arrays."""
    if isinstance(value, np.ndarray) and value.ndim == 2:
        return value
    return tuple(value.tolist()) if isinstance(value, np.ndarray) else value.item() \
        if isinstance(value, np.generic) else value


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
        if str(data["format"]) != _FORMAT or data["count"].sum() != len(data["turns"]):
            raise ValueError(f"format '{data['format']}'; expected '{_FORMAT}'")
    except FileNotFoundError:
        raise
    except Exception as error:  # numpy's and zipfile's own differ by the kind of damage
        raise SceneError(f"{path} is no whole shard: {error}") from error
    return data
