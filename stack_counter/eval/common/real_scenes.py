# SPDX-License-Identifier: Apache-2.0
"""Folders of real scenes with their counted truth, as the authors of 3DC-Real publish them."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.bag.bag_views import BagViews
from stack_counter.bag.nerfstudio import import_scene
from stack_counter.bag.nerfstudio.stacking import read_facts
from stack_counter.config import CollectorConfig
from stack_counter.errors import ConfigError, ScanError
from stack_counter.types import PARTS


@dataclass(frozen=True)
class RealScene:
    """A scene that somebody has counted.

    Attributes:
        folder: with transforms.json, pictures and label images.
        count: number of parts.
        unit_volume: v, m3.
        guesses: numbers that people guessed from the pictures.
    """

    folder: Path
    count: int
    unit_volume: float
    guesses: tuple[float, ...]

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.absolute().name

    @property
    def part(self) -> str:
        """What a part is called: the name without numbers."""
        return re.sub(r"[\d_]+", " ", self.name).strip() or self.name


def read_real_scene(folder: Path) -> RealScene:
    """Reads what a scene states of its parts.

    Raises:
        BagError: its info.json is malformed.
        ConfigError: count or v are not stated.
    """
    facts = read_facts(folder)
    if not (facts.parts and facts.unit_volume_cm3):
        raise ConfigError(f"{folder} states {facts.parts} parts of {facts.unit_volume_cm3:g} cm3; "
                          "expected an info.json with gt_count and unit_volume, cm3")
    return RealScene(folder, facts.parts, facts.unit_volume_cm3 * 1e-6, facts.guesses)


@contextmanager
def imported(scene: RealScene) -> Iterator[Path]:
    """Gives a bag of the scene, which is gone afterwards.

    Raises:
        FileNotFoundError, BagError: as `import_scene`.
    """
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        import_scene(scene.folder, bag)
        yield bag


def crop_key_view(bag: Path, collector: CollectorConfig) -> np.ndarray:
    """The (h, w, 3) uint8 colours of the view with the most part pixels, cropped to them.

    Raises:
        BagError: the bag cannot be read.
        ScanError: no label image shows a part.
    """
    best, most = None, 0
    for _, view in BagViews(bag, collector):
        pixels = 0 if view.labels is None else np.count_nonzero(view.labels == PARTS)
        if view.color is not None and pixels > most:
            best, most = view, pixels
    if best is None:
        raise ScanError("no label image shows a part; expected labels/ with 2 where parts are")
    view = geometry.rectify(best)
    rows, cols = np.nonzero(view.labels == PARTS)
    crop = geometry.crop(view, np.array([cols.min(), rows.min()]),
                         np.array([cols.max(), rows.max()]))
    assert crop.color is not None  # chosen so
    return crop.color
