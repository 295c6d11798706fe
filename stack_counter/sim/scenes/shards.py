# SPDX-License-Identifier: Apache-2.0
"""Scenes in files: a shard holds consecutive scenes, packed, with their truth.

A shard is a zip of arrays with checksums, written beside its place and moved there whole. Parts
are named by family and seed and made again when it is read; those of no training family by family
and place in the folder's library (`set_library`).
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.pose_packing import PackedPoses, pack_poses, unpack_poses
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.scenes.set_library import LIBRARY_FILE, find_library
from stack_counter.sim.scenes.truth import Truth
from stack_counter.sim.shapes import FAMILIES, Shape, make_shape

SCENES_PER_SHARD = 50
_FORMAT = "stack_counter scenes 1"
# Fields that a shard stores under their own names (those of the container behind "container_").
_TRUTH_FIELDS = ("stack_volume", "fill", "gamma_whole", "gamma_center")
_SCENE_FIELDS = ("friction", "restitution", "taps")
_CONTAINER_FIELDS = ("kind", "T_world_container", "inner_size_m", "wall_thickness_m",
                     "floor_thickness_m", "draft_rad", "seed")
# Relative difference of a part's volume above which it is another part than when it was stored:
# above the rounding of a float64 sum, below any change of a generator.
_VOLUME_TOLERANCE = 1e-6


def shard_path(folder: Path, number: int) -> Path:
    """The file of scenes `number` * SCENES_PER_SHARD and following."""
    return folder / f"shard_{number:05d}.npz"


def write_shard(path: Path, scenes: list[Scene], failed_tries: Counter[str]) -> None:
    """Writes scenes of one seed, and how many tries failed for which reason, all or nothing.

    Raises:
        OSError: e.g. the disk is full; what was written is removed.
    """
    arrays = _packed_arrays(scenes, failed_tries)
    unfinished = path.with_suffix(".part")
    try:
        with open(unfinished, "wb") as file:
            np.savez_compressed(file, **arrays)
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def _packed_arrays(scenes: list[Scene], failed_tries: Counter[str]) -> dict[str, Any]:
    """The arrays of a shard by name; their order is part of the format."""
    packed = [pack_poses(scene.poses) for scene in scenes]
    reasons = sorted(failed_tries)
    return {
        "format": _FORMAT, "seed": scenes[0].seed, "index": [s.index for s in scenes],
        "family": [s.shape.family for s in scenes], "shape_seed": [s.shape.seed for s in scenes],
        "unit_volume": [s.shape.unit_volume for s in scenes],
        "count": np.array([len(s.poses) for s in scenes], np.int32),
        "frame": np.array([poses.frame for poses in packed]),
        "positions": np.concatenate([poses.positions for poses in packed]),
        "turns": np.concatenate([poses.turns for poses in packed]),
        "skipped_reason": np.array(reasons, str),
        "skipped": [failed_tries[reason] for reason in reasons],
        **{f"container_{name}": [getattr(s.container, name) for s in scenes]
           for name in _CONTAINER_FIELDS},
        **{name: [getattr(s, name) for s in scenes] for name in _SCENE_FIELDS},
        **{name: [getattr(s.truth, name) for s in scenes] for name in _TRUTH_FIELDS}}


def read_shard(path: Path) -> list[Scene]:
    """Reads the scenes of a file.

    Raises:
        SceneError: damaged, not a shard, made by generators that give other parts, or of a
            library that is not there.
        ShapeError: the library is damaged.
    """
    data = _read_arrays(path)
    library = find_library(path.parent) if not set(data["family"]) <= set(FAMILIES) else ()
    shape: Shape | None = None
    scenes = []
    for i, end in enumerate(np.cumsum(data["count"])):
        # The part: scenes of the same one stand side by side
        family, seed = str(data["family"][i]), int(data["shape_seed"][i])
        if shape is None or (shape.family, shape.seed) != (family, seed):
            shape = _find_shape(family, seed, library, path)
        _check_volume(shape, float(data["unit_volume"][i]), path)
        # Poses, container and truth
        count = int(data["count"][i])
        poses = unpack_poses(PackedPoses(data["frame"][i], data["positions"][end - count:end],
                                         data["turns"][end - count:end]))
        container = ContainerShape(**{name: _to_python(data[f"container_{name}"][i])
                                      for name in _CONTAINER_FIELDS})
        truth = Truth(count, shape.unit_volume, **{n: float(data[n][i]) for n in _TRUTH_FIELDS})
        scenes.append(Scene(int(data["seed"]), int(data["index"][i]), shape, container, poses,
                            **{n: data[n][i].item() for n in _SCENE_FIELDS}, stored_truth=truth))
    return scenes


def _find_shape(family: str, seed: int, library: Sequence[Shape], path: Path) -> Shape:
    """The part of a scene, generated or from the folder's library."""
    if family in FAMILIES:
        return make_shape(seed, family)
    if 0 <= seed < len(library) and (shape := library[seed]).family == family:
        return shape
    raise SceneError(f"{path}: {LIBRARY_FILE} beside it lacks part {seed}, {family}")


def _check_volume(shape: Shape, expected: float, path: Path) -> None:
    """Refuses a part that other generators than those of the scene have made."""
    if abs(shape.unit_volume / expected - 1) > _VOLUME_TOLERANCE:
        raise SceneError(f"{path}: {shape.family} {shape.seed} has {shape.unit_volume} m3; "
                         f"expected {expected}, as when the scene was made: another version of "
                         "the generators")


def read_failed_tries(path: Path) -> Counter[str]:
    """Number of failed tries by reason.

    Raises:
        SceneError: damaged, or not a shard.
    """
    data = _read_arrays(path)
    return Counter(dict(zip(data["skipped_reason"].tolist(), data["skipped"].tolist())))


def read_scenes(folder: Path, limit: int | None = None) -> Iterator[Scene]:
    """All scenes of a folder in order of their index, or the first `limit`.

    Raises:
        SceneError: no shard there, or a damaged one.
    """
    yielded = 0
    for path in shard_paths(folder):
        for scene in read_shard(path):
            if yielded == limit:
                return
            yielded += 1
            yield scene


def shard_paths(folder: Path) -> list[Path]:
    """The shards of a folder in order.

    Raises:
        SceneError: there is none.
    """
    paths = sorted(folder.glob("shard_*.npz"))
    if not paths:
        raise SceneError(f"no shard_*.npz in {folder}; expected those that simulate writes")
    return paths


def find_scene(name: str) -> Scene:
    """The scene that `DIR:INDEX` names.

    Raises:
        SceneError: not of that form, or a damaged shard.
        FileNotFoundError: no such scene.
    """
    folder, _, index = name.rpartition(":")
    if not folder or not index.isdecimal():
        raise SceneError(f"scene '{name}'; expected DIR:INDEX, e.g. data/unseen:12")
    path = shard_path(Path(folder), int(index) // SCENES_PER_SHARD)
    found = [s for s in read_shard(path) if s.index == int(index)] if path.exists() else []
    if not found:
        raise FileNotFoundError(f"no scene {index} in {folder}; expected one that simulate made "
                                "there")
    return found[0]


def _to_python(value: Any) -> Any:
    """The number, text or tuple of an array's element; matrices stay arrays."""
    if isinstance(value, np.ndarray) and value.ndim == 2:
        return value
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return value.item() if isinstance(value, np.generic) else value


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of a shard, its format and counts checked.

    Raises:
        SceneError: damaged, or not a shard.
    """
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
