# SPDX-License-Identifier: Apache-2.0
"""Whether a value can be that of a setting: its type, its range, its choices."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from stack_counter.errors import ConfigError


def check_setting(setting: dataclasses.Field, value: Any) -> Any:
    """Returns the value of a setting, in the type of its default.

    Args:
        setting: field of a settings class of `config`; its metadata hold range and choices.
        value: as a file or ROS gives it.

    Raises:
        ConfigError: wrong type or value out of range.
    """
    default, meta = setting.default, setting.metadata
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)) or any(
                isinstance(x, bool) or not isinstance(x, (int, float)) for x in value):
            raise ConfigError(f"{setting.name} is {value!r}; expected a list of numbers")
        if len(value) != len(default):
            raise ConfigError(f"{setting.name} has {len(value)} numbers; expected {len(default)}")
        value = tuple(float(x) for x in value)
        numbers = value
    elif isinstance(default, float) and isinstance(value, (int, float)) \
            and not isinstance(value, bool):
        value = float(value)
        if math.isnan(value) and math.isnan(default):  # not set; the same object compares equal
            return default
        numbers = (value,)
    elif type(value) is not type(default):
        raise ConfigError(f"{setting.name} is {value!r}; expected {type(default).__name__}")
    else:
        numbers = (value,) if isinstance(value, int) and not isinstance(value, bool) else ()
    low, high = meta["low"], meta["high"]
    for number in numbers:
        if not math.isfinite(number) or (low is not None and number < low) \
                or (high is not None and number > high):
            raise ConfigError(f"{setting.name} is {value}; expected {low} to {high}")
    if meta["choices"] and value not in meta["choices"]:
        raise ConfigError(f"{setting.name} is '{value}'; expected one of {meta['choices']}")
    return value
