# SPDX-License-Identifier: Apache-2.0
"""Scenes of the data set 3DC-Real, as its authors publish them.

    images/ obj_seg/ box_seg/ transforms.json info.json ../unit_volumes.json

`obj_seg` shows the parts, `box_seg` the container with the parts, both by their alpha channel;
scenes without a container lack the latter. Positions are metres.

Source: Dumery et al., "Counting Stacked Objects" (2025); CorentinDumery/3d-counting,
`data_preparation/data_prep.sh` and `process_scene.sh`.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import NamedTuple

from stack_counter.errors import BagError

PARTS_FOLDER, CONTAINER_FOLDER = "obj_seg", "box_seg"


class SceneFacts(NamedTuple):
    """What a scene states of its parts.

    Attributes:
        unit_volume_cm3: volume of one part; 0 where it is not known.
        parts: number of parts, counted by hand; 0 where it is not known.
        guesses: numbers that people guessed from the pictures.
    """

    unit_volume_cm3: float = 0.0
    parts: int = 0
    guesses: tuple[float, ...] = ()


def read_facts(scene: Path) -> SceneFacts:
    """Reads what the scene states of its parts; as the authors do, the common list comes first.

    Raises:
        BagError: a file is malformed.
    """
    info = _read_object(scene / "info.json")
    volumes = _read_object(scene.absolute().parent / "unit_volumes.json")
    name = re.sub(r"\d", "", scene.absolute().name)
    volume = volumes.get(name, info.get("unit_volume_cm3", info.get("unit_volume", 0)))
    try:
        return SceneFacts(max(float(volume), 0.0), max(int(info.get("gt_count", 0)), 0),
                          tuple(map(float, info.get("human_guesses", ()))))
    except (TypeError, ValueError, OverflowError) as error:
        raise BagError(f"{scene / 'info.json'} is malformed ({error}); expected numbers under "
                       "gt_count and unit_volume, cm3, and a list of them under "
                       "human_guesses") from error


def _read_object(path: Path) -> dict:
    """The object of a JSON file; empty where there is no such file."""
    try:
        value = json.loads(path.read_text())
    except FileNotFoundError:
        return {}
    except (ValueError, RecursionError) as error:
        raise BagError(f"{path} is malformed ({error}); expected a JSON object") from error
    return value if isinstance(value, dict) else {}
