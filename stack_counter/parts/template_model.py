# SPDX-License-Identifier: Apache-2.0
"""v of a part from the carved volumes and shapes of its pieces.

A ridge regression, fitted to simulated parts by `python -m stack_counter.train.template`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from stack_counter.errors import PartError
from stack_counter.files import shipped_weights

FORMAT = "stack_counter template 1"


@dataclass(frozen=True)
class TemplateModelSettings:
    """Tunables of the regression. All are chosen.

    Attributes:
        alike_std: standard deviation of the log of the pieces' volumes below which all poses look
            alike.
        max_feature: standard deviations to which features are limited.
    """

    alike_std: float = 0.06
    max_feature: float = 2.5


SETTINGS = TemplateModelSettings()


class UnitVolume(NamedTuple):
    """v of a part, m3, and its standard deviation, m3."""

    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Template:
    """What a scan of K pieces shows.

    Attributes:
        carved: (K,) float64, m3 of each piece that no view has proven empty.
        features: (n,) float64, what the regression reads.
    """

    carved: np.ndarray
    features: np.ndarray

    @property
    def alike(self) -> bool:
        """Whether all pieces look the same: a round part, or all in one pose."""
        return bool(np.log(self.carved).std() < SETTINGS.alike_std)


@dataclass(frozen=True, eq=False)
class TemplateModel:
    """Ridge regression of log v over the smallest piece's carved volume. All arrays are float64.

    Attributes:
        mean: (n,) mean of the features.
        scale: (n,) standard deviation of the features.
        weights: (m,) weights of their polynomial, constant first.
        std: (3,) relative standard deviation of v on families left out: its constant, and its
            decrease with the number of pieces and the part's size.
    """

    mean: np.ndarray
    scale: np.ndarray
    weights: np.ndarray
    std: np.ndarray

    def unit_volume(self, template: Template) -> UnitVolume:
        """Predicts v of the pieces of a template."""
        x = polynomial_features((template.features - self.mean) / self.scale)
        v = float(template.carved.min() * np.exp(x @ self.weights))
        return UnitVolume(v, v * relative_std(self.std, len(template.carved), v))


def relative_std(std: np.ndarray, pieces: int, unit_volume: float) -> float:
    """Standard deviation of v over v, by the number of pieces and v (m3)."""
    return float(np.sqrt(std[0]**2 + std[1]**2 / pieces
                         + std[2]**2 * (1e-6 / unit_volume) ** (2 / 3)))


def polynomial_features(x: np.ndarray) -> np.ndarray:
    """(2 n + 1,) 1, the (n,) features and their squares; features limited to what is usual."""
    x = np.clip(x, -SETTINGS.max_feature, SETTINGS.max_feature)
    return np.concatenate([[1.0], x, x**2])


@cache
def shipped_template_model() -> TemplateModel:
    """The model that comes with the package.

    Raises:
        PartError: the file is of another format.
    """
    path = shipped_weights("template.json")
    document = json.loads(path.read_text())
    if document.pop("format") != FORMAT:
        raise PartError(f"{path} is no template model; expected '{FORMAT}'")
    return TemplateModel(**{key: np.array(value) for key, value in document.items()})
