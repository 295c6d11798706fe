# SPDX-License-Identifier: Apache-2.0
"""Named regions of interest: several stacks in one scan, each counted by itself.

In a settings file they are a nested mapping, which ROS 2 reads as the parameters
`regions.NAME.center_m` and `regions.NAME.size_m`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from stack_counter.errors import ConfigError

REGIONS = "regions"  # the setting that holds them
_KEYS = ("center_m", "size_m")
MOST_REGIONS = 100  # of one scan; chosen: each has topics of its own


@dataclass(frozen=True)
class NamedRegion:
    """An upright box of the world in which one stack is counted.

    Attributes:
        name: letters, digits and _, the first a letter.
        center_m: its centre, world x y z, metres.
        size_m: its size along world x y z, metres, above 0.
    """

    name: str
    center_m: tuple[float, ...]
    size_m: tuple[float, ...]


def read_regions(value: Any) -> tuple[NamedRegion, ...]:
    """Checks the setting `regions`.

    Args:
        value: mapping of names to mappings of `center_m` and `size_m` to three numbers, metres.

    Raises:
        ConfigError: it is no such mapping, or holds too many; the message names the region.
    """
    if not isinstance(value, Mapping):
        raise ConfigError(f"regions is {value!r}; expected names with center_m and size_m each")
    if len(value) > MOST_REGIONS:
        raise ConfigError(f"regions names {len(value)}; expected at most {MOST_REGIONS}")
    return tuple(_read_region(name, box) for name, box in value.items())


def _read_region(name: Any, box: Any) -> NamedRegion:
    if not (isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name)):
        raise ConfigError(f"a region is named {name!r}; expected letters, digits and _, the first "
                          "a letter")
    if not isinstance(box, Mapping) or set(box) != set(_KEYS):
        seen = sorted(map(str, box)) if isinstance(box, Mapping) else repr(box)
        raise ConfigError(f"regions.{name} has {seen}; expected center_m and size_m")
    center, size = (_read_numbers(f"regions.{name}.{key}", box[key]) for key in _KEYS)
    if min(size) <= 0:
        raise ConfigError(f"regions.{name}.size_m is {list(size)}; expected three numbers above 0")
    return NamedRegion(name, center, size)


def _read_numbers(setting: str, value: Any) -> tuple[float, ...]:
    """Returns three finite numbers; a ConfigError names the setting that holds something else."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise ConfigError(f"{setting} is {value!r}; expected three numbers, m")
    numbers = list(value)
    if len(numbers) != 3 or not all(
            isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x)
            for x in numbers):
        raise ConfigError(f"{setting} is {numbers}; expected three numbers, m")
    return tuple(float(x) for x in numbers)


def write_regions(regions: Iterable[NamedRegion]) -> dict[str, dict[str, list[float]]]:
    """Returns the mapping that `read_regions` reads."""
    return {region.name: {"center_m": list(region.center_m), "size_m": list(region.size_m)}
            for region in regions}


def nest(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns settings with dots in their names, as ROS parameters have them, as nested mappings.

    Example: `{"a.b.c": 1}` gives `{"a": {"b": {"c": 1}}}`.

    Raises:
        ConfigError: a name is that of a setting and of a mapping.
    """
    nested: dict[str, Any] = {}
    for name, value in values.items():
        *parents, last = name.split(".")
        inner = nested
        for parent in parents:
            inner = inner.setdefault(parent, {})
            if not isinstance(inner, dict):
                raise ConfigError(f"{parent} is {inner!r} beside {name}; expected one of them")
        inner[last] = value
    return nested
