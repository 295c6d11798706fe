# SPDX-License-Identifier: Apache-2.0
"""The JSON that evaluations write with `--json`; docs/json.md lists what is in it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any


def write_figures(path: Path, figures: object) -> None:
    """Writes figures: dataclasses as objects, and null for numbers that there are not (NaN).

    Raises:
        OSError: the file cannot be written.
    """
    path.write_text(json.dumps(_plain(figures), indent=1, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    """The same in types that JSON has."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
