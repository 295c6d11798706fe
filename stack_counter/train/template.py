# SPDX-License-Identifier: Apache-2.0
"""Fits what `template.py` says of v from pieces on a table, on parts of the training families.

python -m stack_counter.train.template --scans 600 --workers 2 --kept out/template.npz \
        --out stack_counter/weights/template.json
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import StackCounterError
from stack_counter.parts.template import scan_template
from stack_counter.parts.template_model import (
    FORMAT,
    Template,
    TemplateModel,
    polynomial_features,
    relative_std,
)
from stack_counter.sim import lay_out_pieces, make_shape, record


@dataclass(frozen=True)
class TemplateTrainingSettings:
    """Which template scans are simulated, and how the regression is fitted; chosen.

    Attributes:
        seed: seed of the scans.
        views: fewest and most views of a scan.
        pieces: fewest and most pieces on the table.
        folds: parts of the families that are left out in turn.
        penalties: ridge penalties that are tried.
    """

    seed: int = 77
    views: tuple[int, int] = (6, 18)
    pieces: tuple[int, int] = (1, 10)
    folds: int = 6
    penalties: tuple[float, ...] = tuple(np.logspace(-1, 3, 9))


SETTINGS = TemplateTrainingSettings()

@dataclass(frozen=True)
class Example:
    """A template scan of a known part."""

    family: str
    unit_volume: float
    template: Template


def make_example(index: int) -> Example | None:
    """Scan `index`; None if it is refused."""
    random = np.random.default_rng([SETTINGS.seed, index])
    try:
        shape = make_shape(int(random.integers(2**31)))
        pieces = int(random.integers(SETTINGS.pieces[0], SETTINGS.pieces[1] + 1))
        count = int(random.integers(SETTINGS.views[0], SETTINGS.views[1] + 1))
        views = record(
            lay_out_pieces(shape, pieces, SETTINGS.seed, index), count, SETTINGS.seed, color=False
        )
        return Example(shape.family, shape.unit_volume,
                       scan_template(views, pieces, ReconstructorConfig()))
    except StackCounterError as error:
        print(f"scan {index}: {error}", file=sys.stderr)
        return None


def fit_template_model(examples: list[Example], penalty: float) -> TemplateModel:
    """Ridge regression; the constant is free. Its `std` is not set."""
    raw = np.array([e.template.features for e in examples])
    mean, scale = raw.mean(axis=0), raw.std(axis=0) + 1e-6
    x = np.array([polynomial_features((row - mean) / scale) for row in raw])
    y = np.array([np.log(e.unit_volume / e.template.carved.min()) for e in examples])
    ridge = penalty * np.diag([0.0] + [1.0] * (x.shape[1] - 1))
    weights = np.linalg.solve(x.T @ x + ridge, x.T @ y)
    return TemplateModel(mean, scale, weights, np.zeros(3))


def measure_left_out_errors(examples: list[Example], penalty: float) -> np.ndarray:
    """Returns the (n,) logs of fitted over true v, each by a fit without that family."""
    families = sorted({e.family for e in examples})
    fold = {
        f: i % SETTINGS.folds for i, f in enumerate(np.random.default_rng(1).permutation(families))
    }
    out = np.zeros(len(examples))
    for k in range(SETTINGS.folds):
        model = fit_template_model([e for e in examples if fold[e.family] != k], penalty)
        for i, e in enumerate(examples):
            if fold[e.family] == k:
                out[i] = np.log(model.unit_volume(e.template)[0] / e.unit_volume)
    return out


def fit_relative_std(examples: list[Example], misses: np.ndarray) -> np.ndarray:
    """(3,) `TemplateModel.std` of most likelihood, for errors of families left out."""
    def loss(log_std: np.ndarray) -> float:
        std = np.array([relative_std(np.exp(log_std), len(e.template.carved),
                                     e.unit_volume * np.exp(miss))
                        for e, miss in zip(examples, misses)])
        # Laplace, whose scale is the standard deviation over the root of 2: tails are long.
        return float(np.sum(np.log(std) + np.sqrt(2) * np.abs(misses) / std))

    return np.exp(minimize(loss, np.log([0.05, 0.1, 0.05]), method="Nelder-Mead").x)


def main() -> int:
    """Makes the scans, fits, prints the errors on families left out, writes the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=600)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--kept", type=Path, required=True, help="where the scans are kept")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    if not options.kept.exists():
        with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
            made = [e for e in tqdm(pool.map(make_example, range(options.scans)),
                                    total=options.scans, unit=" scans") if e is not None]
        options.kept.parent.mkdir(parents=True, exist_ok=True)
        _write_examples(options.kept, made)
    examples = _read_examples(options.kept)
    penalty = min(
        SETTINGS.penalties,
        key=lambda p: float(np.abs(measure_left_out_errors(examples, p)).mean()),
    )
    misses = measure_left_out_errors(examples, penalty)
    model = fit_template_model(examples, penalty)
    std = fit_relative_std(examples, misses)
    options.out.write_text(json.dumps({
        "format": FORMAT, **{key: np.round(getattr(model, key), 5).tolist()
                             for key in ("mean", "scale", "weights")},
        "std": np.round(std, 5).tolist()}) + "\n")
    many = np.array([len(e.template.carved) >= 5 for e in examples])
    stds = [relative_std(std, len(e.template.carved), e.unit_volume * np.exp(m))
            for m, e in zip(misses, examples)]
    inside = np.abs(misses) < 1.645 * np.array(stds)
    print(f"{len(examples)} scans, penalty {penalty:g}: mean error {np.abs(misses).mean():.3f}, "
          f"of 5 pieces or more {np.abs(misses[many]).mean():.3f} (median "
          f"{np.median(np.abs(misses[many])):.3f}); within 1.645 std {inside.mean():.2f}; std "
          f"{np.round(std, 3)}")
    return 0


def _write_examples(path: Path, examples: list[Example]) -> None:
    np.savez_compressed(
        path, family=[e.family for e in examples], v=[e.unit_volume for e in examples],
        pieces=[len(e.template.carved) for e in examples],
        carved=np.concatenate([e.template.carved for e in examples]),
        features=[e.template.features for e in examples])


def _read_examples(path: Path) -> list[Example]:
    with np.load(path, allow_pickle=False) as file:
        data = {name: file[name] for name in file.files}
    cuts = np.cumsum(data["pieces"])[:-1]
    return [Example(str(family), float(v), Template(carved, features)) for family, v, carved,
            features in zip(data["family"], data["v"], np.split(data["carved"], cuts),
                            data["features"])]


if __name__ == "__main__":
    sys.exit(main())
