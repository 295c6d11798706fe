# SPDX-License-Identifier: Apache-2.0
"""Bias and error model of V: how the fused surface and its edges differ from the true ones.

The numbers are shipped in `weights/volume.json`; this module is the only one that reads them.
`python -m stack_counter.train.volume_model` measures them on training scenes.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

from stack_counter.errors import WeightsError
from stack_counter.files import shipped_weights

FORMAT = "stack_counter volume model 1"


@dataclass(frozen=True)
class VolumeModel:
    """Bias and standard deviations of V's measurement.

    "Relative" is relative to the quantity that is named. Standard deviations are independent of
    each other; `reconstruction.integral.volume_std` adds them up.

    Attributes:
        hidden_share: share of its neighbours' fill height that a cell holds which no view of an
            arc saw, relative.
        hidden_share_one_side: the same inside a container where all views come from one side.
        hidden_share_one_side_heap: the same of a heap where all views come from one side.
        worn_height_m: height by which fusion wears the surface down, on average over the cells
            that hold something, m.
        level_std_m: standard deviation of the level of the whole surface, m, without noise.
        level_std_per_noise: what each metre of the depth's noise adds to that, m/m.
        wall_std_m: standard deviation of the inner wall's place, m.
        filled_in_std: standard deviation of the volume filled in where no view saw, relative.
        floor_std_per_wall: standard deviation of a floor that no view shows and that is taken
            to be as thick as the wall, relative to the wall's thickness.
        volume_std: standard deviation of V beyond all others, relative.
        heap_std: standard deviation of a heap's V beyond that, relative.
        lost_rim_width_m: width of a rim that one camera above does not measure, m, without noise.
        lost_rim_width_per_noise: what each metre of the depth's noise adds to that, m/m.
        lost_rim_width_std: standard deviation of the width that is lost, relative.
        stereo_std: standard deviation that depth from pictures adds to V, relative.
    """

    hidden_share: float
    hidden_share_one_side: float
    hidden_share_one_side_heap: float
    worn_height_m: float
    level_std_m: float
    level_std_per_noise: float
    wall_std_m: float
    filled_in_std: float
    floor_std_per_wall: float
    volume_std: float
    heap_std: float
    lost_rim_width_m: float
    lost_rim_width_per_noise: float
    lost_rim_width_std: float
    stereo_std: float


@cache
def volume_model() -> VolumeModel:
    """Returns the shipped model, which is read once in a process.

    Raises:
        WeightsError: the shipped file is missing, no JSON, of another format, or not whole.
    """
    return read_volume_model(shipped_weights("volume.json"))


def read_volume_model(path: Path) -> VolumeModel:
    """Reads a file that `python -m stack_counter.train.volume_model` wrote.

    Args:
        path: of the file: a JSON object with `format`, and `numbers` that holds an object with
            the finite number `value`, 0 or more, for every attribute of `VolumeModel`.

    Raises:
        WeightsError: the file is missing, no JSON, of another format, or not whole.
    """
    try:
        content = json.loads(path.read_text())
    except OSError as error:
        raise WeightsError(f"no volume model {path}: {error}; expected a JSON file") from error
    except ValueError as error:
        raise WeightsError(f"{path} is no JSON: {error}; expected a volume model") from error
    file_format = content.get("format") if isinstance(content, dict) else type(content).__name__
    if file_format != FORMAT:
        raise WeightsError(f"{path} is '{file_format}'; expected '{FORMAT}'")
    numbers = content.get("numbers")
    if not isinstance(numbers, dict):
        numbers = {}
    return VolumeModel(**{f.name: _number(path, numbers, f.name) for f in fields(VolumeModel)})


def _number(path: Path, numbers: dict, name: str) -> float:
    """Returns the value of one number of the model.

    Raises:
        WeightsError: it is missing, no finite number, or below 0.
    """
    entry = numbers.get(name)
    value = entry.get("value") if isinstance(entry, dict) else None
    if not isinstance(value, (int, float)) or isinstance(value, bool) \
            or not math.isfinite(value) or value < 0:
        raise WeightsError(f"{path}: {name} is {value}; expected a finite number, 0 or more")
    return float(value)
