# SPDX-License-Identifier: Apache-2.0
"""A part's models of gamma, one for each kind of scan, and the file that keeps them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from stack_counter.errors import PartError
from stack_counter.files import write_atomically
from stack_counter.parts.gamma_model import FEATURES, GammaModel

FORMAT = "stack_counter part model 1"
_SCAN_KINDS = ("arc", "one_side")
_SHAPES = {"coefficients": (2, FEATURES), "shared": (2 * FEATURES,) * 2, "noise": (2, 2),
           "least": (2,), "friction": (2,)}


@dataclass(frozen=True)
class PartModels:
    """A part's models of gamma, one for each kind of scan.

    Attributes:
        estimator: name of the estimator that gave `Reading.log_gamma_estimated`.
        arc: for scans with views from around.
        one_side: for single views from above.
        made: text for people that names what they were fitted to.
    """

    estimator: str
    arc: GammaModel
    one_side: GammaModel
    made: str

    def write(self, path: Path) -> None:
        """Writes the models as JSON.

        Raises:
            OSError: the file cannot be written.
        """
        document = {"format": FORMAT, "estimator": self.estimator, "made": self.made,
                    **{kind: _as_lists(getattr(self, kind)) for kind in _SCAN_KINDS}}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, json.dumps(document) + "\n")


def read_models(path: Path) -> PartModels:
    """Reads what `PartModels.write` wrote.

    Raises:
        PartError: the file is missing, or no such file.
    """
    try:
        document = json.loads(path.read_text())
        if document["format"] != FORMAT:
            raise ValueError(f"format '{document['format']}' (not '{FORMAT}')")
        arc, one_side = (_model_of(document[kind]) for kind in _SCAN_KINDS)
        return PartModels(str(document["estimator"]), arc, one_side, str(document["made"]))
    except OSError as error:
        raise PartError(f"no gamma prior {path}: {error.strerror}; expected the file that "
                        "`stack-counter part add` writes") from error
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise PartError(f"{path} is no gamma prior: {error}; expected the file that "
                        "`stack-counter part add` writes") from error


def _model_of(values: dict) -> GammaModel:
    arrays = {key: np.array(values[key], float) for key in (*_SHAPES, "scores")}
    for key, shape in _SHAPES.items():
        if arrays[key].shape != shape:
            raise ValueError(f"{key} of shape {arrays[key].shape} (not {shape})")
    if not arrays["scores"].size:
        raise ValueError("no scores")
    variance = float(values["volume_variance"])
    # The friction of piles of many parts is NaN: it is not known.
    known = [numbers.ravel() for key, numbers in arrays.items() if key != "friction"]
    if not np.isfinite(np.concatenate([*known, [variance]])).all():
        raise ValueError("NaN or infinite numbers (finite ones needed)")
    return GammaModel(volume_variance=variance, source=str(values["source"]), **arrays)


def _as_lists(model: GammaModel) -> dict:
    """Fields of a model with arrays as lists of six digits."""
    return {key: np.array([float(f"{x:.6g}") for x in value.ravel()]).reshape(value.shape).tolist()
            if isinstance(value, np.ndarray) else value for key, value in asdict(model).items()}
