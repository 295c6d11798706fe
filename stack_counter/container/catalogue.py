# SPDX-License-Identifier: Apache-2.0
"""The container catalogue (config/containers.yaml): what empty-bin scans and CAD files say."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.container.inner_map import read_inner_map, write_inner_map
from stack_counter.container.wall_shapes import BoxWall, FreeWall, RoundWall
from stack_counter.errors import ConfigError
from stack_counter.files import (
    config_path,
    edit_yaml_entry,
    parse_yaml,
    read_text,
    write_atomically,
)
from stack_counter.types import InnerMap, WallShape

_NEW_CATALOGUE = """\
# The container catalogue: what the setting `container` looks up.
# Written by `stack-counter container teach NAME BAG` (or --mesh FILE), which keeps your comments.
containers:
"""
_TAUGHT_SETTINGS = ("container_kind", "container_inner_size_m", "container_floor_size_m",
                    "container_wall_m", "container_floor_m")


@dataclass(frozen=True)
class _Key:
    """A key of an entry: its name, how many numbers it holds, their meaning and unit."""

    name: str
    count: int
    meaning: str


_SHAPE_KEYS = {
    "box": (_Key("outer_size_m", 2, "x (the longer) and y of the outer face at the rim, m"),
            _Key("draft", 1, "by how much the walls come in for each metre down, m/m")),
    "round": (_Key("outer_radius_m", 1, "R of the outer face at the rim, m"),
              _Key("lean", 1, "p in r^2 = R^2 - 2 p R z - q z^2, z below the rim, m/m"),
              _Key("bend", 1, "q, m2/m2")),
    "free": (_Key("outer_radius_m", 17, "outer face at the rim: mean, 8 cosines, 8 sines, m"),
             _Key("lean", 9, "by how much it comes in for each metre down: mean, 4, 4, m/m"),
             _Key("bend", 1, "and with the square of that, over the mean radius, m/m")),
}
_SIZE_KEYS = (_Key("wall_m", 1, "thickness of the wall, horizontal, m"),
              _Key("floor_m", 1, "thickness of the floor, m"),
              _Key("rim_m", 1, "height of the rim above the support plane, m"))
_MAP_FOLDER = "containers"  # beside the catalogue
_MAP_MEANINGS = {"inner_map": "inner surface, from this file's folder",
                 "inner_pitch_m": "side of a pixel of it, m"}


@dataclass(frozen=True, eq=False)
class TaughtContainer:
    """A container as an empty-bin scan measured it, or as its CAD file says.

    Attributes:
        wall_shape: outer face of its wall in the container frame: x along a box's longer side,
            else along the world's x when it was taught.
        wall_m: thickness of the wall, measured horizontally, metres.
        floor_m: thickness of the floor, metres.
        rim_m: height of the rim above the support plane, metres.
        taught: when it was taught, and from which recording or CAD file.
        inner_map: inner surface by a CAD file; None for one that was measured.
    """

    wall_shape: WallShape
    wall_m: float
    floor_m: float
    rim_m: float
    taught: str = ""
    inner_map: InnerMap | None = None


def catalogue_path(config: ReconstructorConfig) -> Path:
    """Path of the configured catalogue, else of the shipped one.

    Raises:
        ConfigError: none is configured and the shipped one is missing.
    """
    configured = config.container_catalogue
    return Path(configured) if configured else config_path("containers.yaml")


def load_containers(path: Path | None = None, with_map_of: str = ""
                    ) -> dict[str, TaughtContainer]:
    """Reads a catalogue.

    Args:
        path: of the catalogue; None is the shipped one.
        with_map_of: name of the container whose inner map is read, too.

    Returns:
        Taught containers by name, in the order of the file, the others without inner maps.

    Raises:
        ConfigError: the catalogue is missing or malformed, or the inner map cannot be read.
    """
    path = path or config_path("containers.yaml")
    try:
        return _parse_containers(read_text(path), path, with_map_of)
    except OSError as error:
        raise ConfigError(f"no container catalogue {path}: {error.strerror}") from error


def configured_container(config: ReconstructorConfig) -> TaughtContainer | None:
    """The taught container that the setting `container` names; None where it names none.

    Raises:
        ConfigError: the catalogue is missing or malformed, or does not hold it, its inner map
            cannot be read, or another setting contradicts it.
    """
    if not config.container:
        return None
    for field in dataclasses.fields(config):
        if field.name in _TAUGHT_SETTINGS and getattr(config, field.name) != field.default:
            raise ConfigError(f"{field.name} is {getattr(config, field.name)} beside container "
                              f"'{config.container}', which says it; expected {field.default}")
    containers = load_containers(catalogue_path(config), config.container)
    if config.container not in containers:
        raise ConfigError(f"unknown container '{config.container}'; expected one of "
                          f"{sorted(containers)}")
    return containers[config.container]


def save_container(name: str, container: TaughtContainer, path: Path) -> None:
    """Writes an entry into a catalogue, which is made if it is not there.

    Its inner map, if it has one, becomes a picture in a folder beside the catalogue.

    Raises:
        ConfigError: the catalogue is malformed, or would be with this container.
        OSError: a file cannot be written.
    """
    text = _NEW_CATALOGUE
    if path.exists():
        text = read_text(path)
        _parse_containers(text, path)  # raises what is wrong with it before it is changed
    keys = (*_SHAPE_KEYS[container.wall_shape.kind], *_SIZE_KEYS)
    meanings = {"kind": "box, round or free", "taught": "when, from which recording or CAD file",
                **{key.name: key.meaning for key in keys}, **_MAP_MEANINGS}
    entry = _entry_from_container(container)
    if container.inner_map is not None:
        entry |= {"inner_map": f"{_MAP_FOLDER}/{name}.png",
                  "inner_pitch_m": float(f"{container.inner_map.pitch:.7g}")}
    text = edit_yaml_entry(text, "containers", name, entry, meanings)
    _parse_containers(text, path)  # raises what could not be read again
    if container.inner_map is not None:
        write_inner_map(path.parent / _MAP_FOLDER / f"{name}.png", container.inner_map)
    write_atomically(path, text)


def describe_container(name: str, container: TaughtContainer) -> str:
    """One line for people that describes a taught container."""
    x, y = np.ptp(container.wall_shape.ring(0.0, container.wall_m), axis=0) * 1000
    return (f"{name}: {container.wall_shape.kind}, {x:.0f} x {y:.0f} mm inside at the rim, "
            f"{(container.rim_m - container.floor_m) * 1000:.0f} mm deep, wall "
            f"{container.wall_m * 1000:.1f} mm, floor {container.floor_m * 1000:.1f} mm "
            f"({container.taught})")


def _parse_containers(text: str, path: Path, with_map_of: str = "") -> dict[str, TaughtContainer]:
    try:
        document = parse_yaml(text)
        if not isinstance(document, dict):
            raise ValueError(type(document).__name__)
        if "containers" not in document:
            raise ValueError(f"{sorted(map(str, document))}")
        return {str(name): _container_from_entry(
                    entry, path.parent if str(name) == with_map_of else None)
                for name, entry in (document["containers"] or {}).items()}
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{path} is malformed at {error}; expected 'containers: NAME:' and what "
                          "`stack-counter container teach` writes below it") from error


def _container_from_entry(entry: Mapping[str, Any], map_folder: Path | None) -> TaughtContainer:
    """Makes a container of its entry, without the inner map where no folder of it is given."""
    kind = entry["kind"]
    if kind not in _SHAPE_KEYS:
        raise ValueError(f"kind: {kind} (one of {sorted(_SHAPE_KEYS)} needed)")
    # The wall stands in its own frame: a box without yaw and middle, others without middle.
    params = _checked_numbers(entry, _SHAPE_KEYS[kind])
    shapes: dict[str, WallShape] = {"box": BoxWall(np.concatenate([np.zeros(3), params])),
                                    "round": RoundWall(np.concatenate([np.zeros(2), params])),
                                    "free": FreeWall(params, np.zeros(2))}
    wall, floor, rim = (float(x) for x in _checked_numbers(entry, _SIZE_KEYS))
    if rim <= floor:
        raise ValueError(f"rim_m: {rim} (above floor_m, {floor}, needed)")
    inner_map = None
    if "inner_map" in entry:
        (pitch,) = _checked_numbers(entry, (_Key("inner_pitch_m", 1, ""),))
        if pitch == 0:
            raise ValueError(f"inner_pitch_m: {pitch} (above 0 needed)")
        if map_folder is not None:
            inner_map = read_inner_map(map_folder / str(entry["inner_map"]), float(pitch))
    return TaughtContainer(shapes[kind], wall, floor, rim, str(entry.get("taught", "")), inner_map)


def _checked_numbers(entry: Mapping[str, Any], keys: Sequence[_Key]) -> np.ndarray:
    """(n,) float64 numbers of some keys, one after the other."""
    numbers = []
    for key in keys:
        values = np.atleast_1d(np.array(entry[key.name], float))
        if values.shape != (key.count,) or not np.isfinite(values).all():
            raise ValueError(f"{key.name}: {entry[key.name]} ({key.count} numbers needed)")
        if key.name.endswith("_m") and values[0] < 0:
            raise ValueError(f"{key.name}: {entry[key.name]} (0 or more needed)")
        numbers.append(values)
    return np.concatenate(numbers)


def _entry_from_container(container: TaughtContainer) -> dict[str, Any]:
    """What the catalogue holds of a container, by key."""
    keys = _SHAPE_KEYS[container.wall_shape.kind]
    numbers = [*container.wall_shape.params[-sum(key.count for key in keys):], container.wall_m,
               container.floor_m, container.rim_m]
    entry: dict[str, Any] = {"kind": container.wall_shape.kind}
    for key in (*keys, *_SIZE_KEYS):
        values = [float(f"{x:.7g}") for x in numbers[:key.count]]
        del numbers[:key.count]
        entry[key.name] = values if key.count > 1 else values[0]
    return {**entry, "taught": container.taught}
