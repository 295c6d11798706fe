"""The container catalogue: what empty-bin scans have taught (config/containers.yaml)."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from stack_counter.config import ReconstructorConfig
from stack_counter.container.wall_shapes import BoxWall, FreeWall, RoundWall, WallShape
from stack_counter.errors import ConfigError, ScanError
from stack_counter.files import config_path, write_atomically
from stack_counter.types import StackVolume

_MOST_IN_IT = 0.02  # share of its capacity that an empty container may seem to hold
_HEAD = """\
# The container catalogue: what the setting `container` looks up.
# Written by `stack-counter container teach NAME BAG`, which keeps entries but not your comments.
"""
_TAUGHT_SETTINGS = ("container_kind", "container_inner_size_m", "container_wall_m",
                    "container_floor_m")
# Lines of an entry by kind: key, how many numbers, meaning and unit.
_FORM_LINES = {
    "box": (("outer_size_m", 2, "x (the longer) and y of the outer face at the rim, m"),
            ("draft", 1, "by how much the walls come in for each metre down, m/m")),
    "round": (("outer_radius_m", 1, "R of the outer face at the rim, m"),
              ("lean", 1, "p in r^2 = R^2 - 2 p R z - q z^2, z below the rim, m/m"),
              ("bend", 1, "q, m2/m2")),
    "free": (("outer_radius_m", 17, "outer face at the rim: mean, 8 cosines, 8 sines, m"),
             ("lean", 9, "by how much it comes in for each metre down: mean, 4, 4, m/m"),
             ("bend", 1, "and with the square of that, over the mean radius, m/m")),
}
_SIZE_LINES = (("wall_m", 1, "thickness of the wall, horizontal, m"),
               ("floor_m", 1, "thickness of the floor, m"),
               ("rim_m", 1, "height of the rim above the support plane, m"))


@dataclass(frozen=True)
class TaughtContainer:
    """A container as an empty-bin scan measured it.

    Attributes:
        form: outer face of its wall, container frame: x along a box's longer side, else along
            the world's x when it was taught.
        wall_m, floor_m: thickness, metres; the wall's is measured horizontally.
        rim_m: height of the rim above the support plane, metres.
        taught: when and from what.
    """

    form: WallShape
    wall_m: float
    floor_m: float
    rim_m: float
    taught: str = ""


def taught_from(volume: StackVolume, taught: str) -> TaughtContainer:
    """What the scan of an empty container teaches.

    Raises:
        ScanError: no container was found, or it is not empty.
    """
    box, inner = volume.container, volume.inner
    if box.form is None or inner is None:
        raise ScanError(f"container is '{box.kind}'; expected a box, round or free one in views "
                        "with depth")
    rim = box.floor_thickness_m + box.inner_size_m[2]
    capacity = float(np.nansum(rim - inner.heights)) * inner.pitch**2
    if volume.stack_volume > _MOST_IN_IT * capacity:
        raise ScanError(f"the container holds {volume.stack_volume * 1e6:.0f} cm3, "
                        f"{volume.stack_volume / capacity:.1%} of its capacity; expected an empty "
                        f"one, at most {_MOST_IN_IT:.0%}")
    form = box.form
    if isinstance(form, BoxWall) and form.params[3] < form.params[4]:
        # A given yaw can only be understood if it is known which side is x: the longer one.
        form = BoxWall(form.params[[0, 1, 2, 4, 3, 5]])
    return TaughtContainer(form, box.wall_thickness_m, box.floor_thickness_m, rim, taught)


def catalogue_path(config: ReconstructorConfig) -> Path:
    """The configured catalogue, else the shipped one."""
    given = config.container_catalogue
    return Path(given) if given else config_path("containers.yaml")


def load_containers(path: Path | None = None) -> dict[str, TaughtContainer]:
    """Taught containers by name; None is the shipped catalogue.

    Raises:
        ConfigError: the catalogue is missing or malformed.
    """
    path = path or config_path("containers.yaml")
    try:
        document = yaml.safe_load(path.read_text())
        return {str(name): _container(entry) for name, entry in
                (document.get("containers") or {}).items()}
    except OSError as error:
        raise ConfigError(f"no container catalogue {path}: {error.strerror}") from error
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path} is malformed at {error}; expected 'containers: NAME:' and what "
                          "`stack-counter container teach` writes below it") from error


def configured_container(config: ReconstructorConfig) -> TaughtContainer | None:
    """The taught container that the setting `container` names; None where it names none.

    Raises:
        ConfigError: the catalogue is missing or malformed, or does not hold it, or another
            setting says something else about the container.
    """
    if not config.container:
        return None
    for field in dataclasses.fields(config):
        if field.name in _TAUGHT_SETTINGS and getattr(config, field.name) != field.default:
            raise ConfigError(f"{field.name} is {getattr(config, field.name)} beside container "
                              f"'{config.container}', which says it; expected {field.default}")
    containers = load_containers(catalogue_path(config))
    if config.container not in containers:
        raise ConfigError(f"unknown container '{config.container}'; expected one of "
                          f"{sorted(containers)}")
    return containers[config.container]


def save_container(name: str, container: TaughtContainer, path: Path) -> None:
    """Writes an entry into a catalogue, which is made if it is not there.

    Raises:
        ConfigError: the catalogue is malformed.
    """
    containers = load_containers(path) if path.exists() else {}
    containers[name] = container
    write_atomically(path, _HEAD + "containers:\n" + "".join(
        _entry(name, containers[name]) for name in sorted(containers)))


def as_line(name: str, container: TaughtContainer) -> str:
    """One line for people."""
    x, y = np.ptp(container.form.ring(0.0, container.wall_m), axis=0) * 1000
    return (f"{name}: {container.form.kind}, {x:.0f} x {y:.0f} mm inside at the rim, "
            f"{(container.rim_m - container.floor_m) * 1000:.0f} mm deep, wall "
            f"{container.wall_m * 1000:.1f} mm, floor {container.floor_m * 1000:.1f} mm "
            f"({container.taught})")


def _numbers(entry: Mapping[str, Any], lines: tuple[tuple[str, int, str], ...]) -> np.ndarray:
    found = []
    for key, count, _ in lines:
        values = np.atleast_1d(np.array(entry[key], float))
        if values.shape != (count,) or not np.isfinite(values).all():
            raise ValueError(f"{key}: {entry[key]} ({count} numbers needed)")
        if key.endswith("_m") and values[0] < 0:
            raise ValueError(f"{key}: {entry[key]} (0 or more needed)")
        found.append(values)
    return np.concatenate(found)


def _container(entry: Mapping[str, Any]) -> TaughtContainer:
    kind = entry["kind"]
    if kind not in _FORM_LINES:
        raise ValueError(f"kind: {kind} (one of {sorted(_FORM_LINES)} needed)")
    params = _numbers(entry, _FORM_LINES[kind])
    forms: dict[str, WallShape] = {"box": BoxWall(np.concatenate([np.zeros(3), params])),
                                   "round": RoundWall(np.concatenate([np.zeros(2), params])),
                                   "free": FreeWall(params, np.zeros(2))}
    wall, floor, rim = (float(x) for x in _numbers(entry, _SIZE_LINES))
    if rim <= floor:
        raise ValueError(f"rim_m: {rim} (above floor_m, {floor}, needed)")
    return TaughtContainer(forms[kind], wall, floor, rim, str(entry.get("taught", "")))


def _entry(name: str, container: TaughtContainer) -> str:
    """The YAML of one entry; a comment on each line."""
    form = container.form
    lines = _FORM_LINES[form.kind]
    values = [*form.params[-sum(count for _, count, _ in lines):], container.wall_m,
              container.floor_m, container.rim_m]
    text = f"  {json.dumps(name)}:\n    kind: {form.kind}  # box, round or free\n"
    for key, count, meaning in (*lines, *_SIZE_LINES):
        numbers = [float(f"{x:.7g}") for x in values[:count]]
        del values[:count]
        text += f"    {key}: {numbers if count > 1 else numbers[0]}  # {meaning}\n"
    return text + f"    taught: {json.dumps(container.taught)}  # when, from which recording\n"
