# SPDX-License-Identifier: Apache-2.0
"""Settings as fields of dataclasses: each with its meaning and range, by which it is checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from stack_counter.config.parameter_files import nearest_name
from stack_counter.errors import ConfigError

Settings = TypeVar("Settings")


def setting(default: Any, doc: str, low: float | None = None, high: float | None = None,
            choices: tuple[str, ...] = (), runtime: bool = False,
            read: Callable[[Any], Any] | None = None, path: bool = False) -> Any:
    """Makes a dataclass field with its description and range.

    `runtime` tells whether the setting may change while its node is configured; `read` makes a
    value of what stands in a file, where that is neither a text nor of numbers; `path` tells
    whether it names a file or folder, which whoever reaches the node by the network may not.
    """
    return dataclasses.field(default=default, metadata={
        "doc": doc, "low": low, "high": high, "choices": choices, "runtime": runtime,
        "read": read, "path": path})


def is_inline(text: str) -> bool:
    """Whether a setting that may name a file holds the file's text itself, in braces."""
    return text.lstrip().startswith("{")


def path_refusal(field: dataclasses.Field, value: Any) -> str:
    """Says why a request may not give a setting this value; empty where it names no path."""
    may_be_inline = field.metadata["runtime"]
    if not field.metadata["path"] or not value or may_be_inline and is_inline(str(value)):
        return ""
    inline = ", or its text in braces" if may_be_inline else ""
    return (f"{field.name} is {value!r}, a path, which no request may name; expected it where the "
            f"node is started: in the parameter file, or as -p {field.name}:=...{inline}")


def build_section(section: type[Settings], values: Mapping[str, Any]) -> Settings:
    """A checked settings object.

    Args:
        section: a dataclass whose fields are made by `setting`.
        values: settings by name; the others keep their defaults.

    Raises:
        ConfigError: unknown name, wrong type or value out of range.
    """
    fields = {f.name: f for f in dataclasses.fields(section)}  # type: ignore[arg-type]
    checked: dict[str, Any] = {}
    for name, value in values.items():
        if name not in fields:
            near = nearest_name(str(name), fields)  # in YAML a name may be a number, or nothing
            raise ConfigError(f"unknown setting {name!r}; expected "
                              + (f"'{near}'" if near else f"one of {sorted(fields)}"))
        read = fields[name].metadata["read"]
        try:
            checked[name] = read(value) if read else _check_value(fields[name], value)
        except OverflowError as error:  # a whole number of hundreds of digits
            raise ConfigError(f"{name} holds a number beyond 1e308; expected one below") from error
    return section(**checked)


def _check_value(field: dataclasses.Field, value: Any) -> Any:
    default, meta = field.default, field.metadata
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)) or any(
                isinstance(x, bool) or not isinstance(x, (int, float)) for x in value):
            raise ConfigError(f"{field.name} is {value!r}; expected a list of numbers")
        if len(value) != len(default):
            raise ConfigError(f"{field.name} has {len(value)} numbers; expected {len(default)}")
        value = tuple(float(x) for x in value)
        numbers = value
    elif isinstance(default, float) and isinstance(value, (int, float)) \
            and not isinstance(value, bool):
        value = float(value)
        if math.isnan(value) and math.isnan(default):  # not set; the same object compares equal
            return default
        numbers = (value,)
    elif type(value) is not type(default):
        raise ConfigError(f"{field.name} is {value!r}; expected {type(default).__name__}")
    else:
        numbers = (value,) if isinstance(value, int) and not isinstance(value, bool) else ()
    low, high = meta["low"], meta["high"]
    for number in numbers:
        if not math.isfinite(number) or (low is not None and number < low) \
                or (high is not None and number > high):
            raise ConfigError(f"{field.name} is {value}; expected {low} to {high}")
    if meta["choices"] and value not in meta["choices"]:
        raise ConfigError(f"{field.name} is '{value}'; expected one of {meta['choices']}")
    return value
