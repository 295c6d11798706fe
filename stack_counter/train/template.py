# SPDX-License-Identifier: Apache-2.0
"""Fits v from pieces on a table, the template model, on parts of the training families.

python -m stack_counter.train.template --scans 600 --workers 2 --kept out/template.npz \
        --out stack_counter/weights/template.json
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

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
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.tasks.progress import progress


@dataclass(frozen=True)
class TemplateTrainingSettings:
    """How scans are drawn and the model is chosen; all chosen.

    Attributes:
        seed: of shapes, layouts and noise.
        views: smallest and largest number of views of a scan.
        pieces: smallest and largest number of pieces on the table.
        folds: groups of families, each left out once.
        penalties: of the ridge regression, of which the best on families left out is taken.
        many_pieces: pieces from which on the printed errors are shown apart.
    """

    seed: int = 77
    views: tuple[int, int] = (6, 18)
    pieces: tuple[int, int] = (1, 10)
    folds: int = 6
    penalties: tuple[float, ...] = tuple(np.logspace(-1, 3, 9))
    many_pieces: int = 5


SETTINGS = TemplateTrainingSettings()


@dataclass(frozen=True, eq=False)
class Example:
    """A template scan of a known part.

    Attributes:
        family: of the part's shape.
        unit_volume: true v, m3.
        template: what the scan has measured.
    """

    family: str
    unit_volume: float
    template: Template


def simulate_example(index: int) -> Example | None:
    """Records pieces of a random part and measures them; None if the scan is refused."""
    random = np.random.default_rng([SETTINGS.seed, index])
    try:
        shape = make_shape(int(random.integers(2**31)))
        pieces = int(random.integers(SETTINGS.pieces[0], SETTINGS.pieces[1] + 1))
        count = int(random.integers(SETTINGS.views[0], SETTINGS.views[1] + 1))
        views = record(lay_out_pieces(shape, pieces, SETTINGS.seed, index), count, SETTINGS.seed,
                       color=False)
        return Example(shape.family, shape.unit_volume,
                       scan_template(views, pieces, ReconstructorConfig()))
    except StackCounterError as error:
        print(f"scan {index}: {error}", file=sys.stderr)
        return None


def fit_model(examples: list[Example], penalty: float) -> TemplateModel:
    """Fits log v by ridge regression; the constant is free, and `std` is not set."""
    raw = np.array([e.template.features for e in examples])
    mean, scale = raw.mean(axis=0), raw.std(axis=0) + 1e-6
    x = np.array([polynomial_features((row - mean) / scale) for row in raw])
    y = np.array([np.log(e.unit_volume / e.template.carved.min()) for e in examples])
    ridge = penalty * np.diag([0.0] + [1.0] * (x.shape[1] - 1))
    weights = np.linalg.solve(x.T @ x + ridge, x.T @ y)
    return TemplateModel(mean, scale, weights, np.zeros(3))


def left_out_errors(examples: list[Example], penalty: float) -> np.ndarray:
    """(n,) log of estimated over true v, each by a fit without that fold of families."""
    families = np.random.default_rng(1).permutation(sorted({e.family for e in examples}))
    fold = {family: i % SETTINGS.folds for i, family in enumerate(families)}
    errors = np.zeros(len(examples))
    for number in range(SETTINGS.folds):
        model = fit_model([e for e in examples if fold[e.family] != number], penalty)
        for i, e in enumerate(examples):
            if fold[e.family] == number:
                errors[i] = np.log(model.unit_volume(e.template)[0] / e.unit_volume)
    return errors


def fit_error_model(examples: list[Example], log_errors: np.ndarray) -> np.ndarray:
    """(3,) `TemplateModel.std` of maximum likelihood, for errors of families left out."""
    def negative_log_likelihood(log_std: np.ndarray) -> float:
        std = predicted_std(np.exp(log_std), examples, log_errors)
        # Laplace, whose scale is the standard deviation over the root of 2: tails are long.
        return float(np.sum(np.log(std) + np.sqrt(2) * np.abs(log_errors) / std))

    return np.exp(minimize(negative_log_likelihood, np.log([0.05, 0.1, 0.05]),
                           method="Nelder-Mead").x)


def predicted_std(std: np.ndarray, examples: list[Example], log_errors: np.ndarray) -> np.ndarray:
    """(n,) relative standard deviation that a `TemplateModel.std` predicts for estimates."""
    return np.array([relative_std(std, len(e.template.carved), e.unit_volume * np.exp(error))
                     for e, error in zip(examples, log_errors)])


def main() -> int:
    """Makes the scans, fits, prints the errors on families left out, writes the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=600)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--kept", type=Path, required=True, help="where the scans are kept")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    # Simulate the scans, unless they are stored.
    if not options.kept.exists():
        with worker_pool(options.workers) as pool:
            examples = progress(pool.map(simulate_example, range(options.scans)), "templates",
                                "scans", options.scans)
            made = [example for example in examples if example is not None]
        options.kept.parent.mkdir(parents=True, exist_ok=True)
        _save_examples(options.kept, made)
    examples = _load_examples(options.kept)
    # Fit, with the penalty that is best on families left out.
    penalty = min(SETTINGS.penalties,
                  key=lambda p: float(np.abs(left_out_errors(examples, p)).mean()))
    log_errors = left_out_errors(examples, penalty)
    model = fit_model(examples, penalty)
    std = fit_error_model(examples, log_errors)
    options.out.write_text(json.dumps({
        "format": FORMAT, **{key: np.round(getattr(model, key), 5).tolist()
                             for key in ("mean", "scale", "weights")},
        "std": np.round(std, 5).tolist()}) + "\n")
    # Print the errors.
    many = np.array([len(e.template.carved) >= SETTINGS.many_pieces for e in examples])
    inside = np.abs(log_errors) < 1.645 * predicted_std(std, examples, log_errors)
    print(f"{len(examples)} scans, penalty {penalty:g}: mean error "
          f"{np.abs(log_errors).mean():.3f}, of {SETTINGS.many_pieces} pieces or more "
          f"{np.abs(log_errors[many]).mean():.3f} (median "
          f"{np.median(np.abs(log_errors[many])):.3f}); within 1.645 std {inside.mean():.2f}; "
          f"std {np.round(std, 3)}")
    return 0


def _save_examples(path: Path, examples: list[Example]) -> None:
    np.savez_compressed(
        path, family=[e.family for e in examples], v=[e.unit_volume for e in examples],
        pieces=[len(e.template.carved) for e in examples],
        carved=np.concatenate([e.template.carved for e in examples]),
        features=[e.template.features for e in examples])


def _load_examples(path: Path) -> list[Example]:
    with np.load(path, allow_pickle=False) as file:
        data = {name: file[name] for name in file.files}
    cuts = np.cumsum(data["pieces"])[:-1]
    return [Example(str(family), float(v), Template(carved, features)) for family, v, carved,
            features in zip(data["family"], data["v"], np.split(data["carved"], cuts),
                            data["features"])]


if __name__ == "__main__":
    sys.exit(main())
