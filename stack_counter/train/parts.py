"""What the scans of one part in one container have in common, of parts that the estimator had not
seen: `weights/parts.json`, by which one counted bin corrects a part that has no CAD file.
docs/parts.md says how SCANS and SINGLE, of `simulate --plan rig`, were made.

    python -m stack_counter.train.parts SCANS --one-view SINGLE --families RUN/families.json \
        --out WEIGHTS

A mixed model (`part_model`): the coefficients of 1 and of the height differ from rig to rig, by a
covariance that is found by maximum likelihood, as is the rest.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import minimize

from stack_counter.occupancy.checkpoint import load_members
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH
from stack_counter.occupancy.training_domain import TrainingDomain
from stack_counter.parts.gamma_model import FEATURES, GammaModel, Reading, fill_features
from stack_counter.parts.part_models import PartModels
from stack_counter.sim import SCENES_PER_RIG
from stack_counter.train.calibrate import Residual, center_of, residuals
from stack_counter.train.data.batches import fold_of
from stack_counter.train.data.fused import read_scans

_SHARED = 2  # coefficients that differ from rig to rig: of 1 and of the height
_FOLDS = 6  # of rigs, for the scores
_LEAST = 4  # scans of a rig
_SCORES = 400  # kept, evenly spaced
Rigs = list[list[tuple[Reading, float]]]  # of each rig the readings, with V's relative deviation


def rigs_of(of: list[Residual], center: float) -> Rigs:
    """Scans by rig: of the same run, container and part."""
    rigs = defaultdict(list)
    for r in of:
        if r.scan.found:
            true = np.log(r.scan.sample.gamma * r.scan.true_volume / r.scan.volume)
            rigs[_rig(r)].append((Reading(*_size(r), np.log(r.gamma) + center, true),
                                  r.scan.volume_std / r.scan.volume))
    return [rig for rig in rigs.values() if len(rig) >= _LEAST]


def _rig(of: Residual) -> tuple[str, int, float]:
    sample = of.scan.sample
    seed, index = sample.name.split(":")
    return seed, int(index) // SCENES_PER_RIG, sample.length_m


def _size(of: Residual) -> tuple[float, float]:
    """Height and width as `Reading` says."""
    sample = of.scan.sample
    area = np.count_nonzero(sample.maps.valid) / PIXELS_PER_LENGTH**2
    return of.scan.volume / sample.length_m**3 / area, float(np.sqrt(area))


def volume_errors(of: list[Residual]) -> tuple[np.ndarray, float]:
    """Log V's error: covariance (2, 2) between rigs of the coefficients of 1 and 1 / (h + 1/2),
    and standard deviation within them, by maximum likelihood; of scans less than 15% off: what is
    farther off has missed its container.
    """
    rigs = defaultdict(list)
    for r in of:
        error = np.log(r.scan.volume / r.scan.true_volume)
        if r.scan.found and abs(error) < 0.15:
            rigs[_rig(r)].append((error, *_size(r)))
    groups = [np.array(rig) for rig in rigs.values() if len(rig) >= _LEAST]
    seen = [(g[:, 0], fill_features(g[:, 1], g[:, 2])[:, :_SHARED]) for g in groups]

    def root(p: np.ndarray) -> np.ndarray:
        return np.array([[p[0], 0.0], [p[1], p[2]]])

    def loss(p: np.ndarray) -> float:
        out = 0.0
        for error, x in seen:
            covariance = x @ root(p) @ root(p).T @ x.T + p[3]**2 * np.eye(len(x))
            left = error - x @ p[4:]
            out += np.linalg.slogdet(covariance)[1] + left @ np.linalg.solve(covariance, left)
        return float(out)

    p = minimize(loss, [0.02, 0.0, 0.02, 0.02, 0.0, 0.0], method="Nelder-Mead",
                 options={"maxiter": 8000, "maxfev": 8000}).x
    return root(p) @ root(p).T, abs(float(p[3]))


class Mixed(torch.nn.Module):
    """The mixed model's parameters."""

    def __init__(self) -> None:
        super().__init__()
        def square(n: int, size: float) -> torch.nn.Parameter:
            return torch.nn.Parameter(size * torch.eye(n, dtype=torch.double))
        self.coefficients = torch.nn.Parameter(torch.zeros(2, FEATURES, dtype=torch.double))
        self.shared, self.noise = square(2 * _SHARED, 0.15), square(2, 0.08)

    def loss(self, x: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Negative log likelihood of a rig's (2 n,) values, features (n, FEATURES)."""
        both = torch.kron(torch.eye(2, dtype=torch.double), x[:, :_SHARED].contiguous())
        shared, noise = (a.tril() @ a.tril().T for a in (self.shared, self.noise))
        covariance = both @ shared @ both.T + torch.kron(noise, torch.eye(len(x)).double())
        covariance = covariance + 1e-8 * torch.eye(len(covariance)).double()
        mean = (x @ self.coefficients.T).T.reshape(-1)
        return -torch.distributions.MultivariateNormal(mean, covariance).log_prob(values)


def fit(rigs: Rigs) -> GammaModel:
    """The model of maximum likelihood; without scores."""
    data = [
        (
            torch.tensor(
                fill_features(np.array([s.height for s, _ in rig]),
                              np.array([s.width for s, _ in rig]))
            ),
            torch.tensor(
                np.array([[s.log_gamma_counted, s.log_gamma_estimated] for s, _ in rig]).T.ravel()
            ),
        )
        for rig in rigs
    ]
    net = Mixed()
    steps = torch.optim.LBFGS(net.parameters(), max_iter=200, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        steps.zero_grad()
        loss = torch.stack([net.loss(x, values) for x, values in data]).mean()
        loss.backward()
        return loss

    steps.step(closure)
    b, shared, noise = (p.detach() for p in (net.coefficients, net.shared, net.noise))
    full = np.zeros((2, FEATURES, 2, FEATURES))
    full[:, :_SHARED, :, :_SHARED] = (shared.tril() @ shared.tril().T).numpy().reshape(
        2, _SHARED, 2, _SHARED)
    every = [pair for rig in rigs for pair in rig]
    return GammaModel(
        b.numpy(), full.reshape(2 * FEATURES, 2 * FEATURES),
        (noise.tril() @ noise.tril().T).numpy(), float(np.mean([v**2 for _, v in every])),
        np.zeros(1), np.array([min(s.height for s, _ in every), min(s.width for s, _ in every)]),
        np.full(2, np.nan), "training")


def errors(rigs: Rigs, counted: int) -> tuple[np.ndarray, np.ndarray]:
    """Log errors of scans of rigs left out, when so many other scans of theirs are counted, and
    the same in standard deviations.
    """
    random = np.random.default_rng(0)
    misses, scores = [], []
    for fold in range(_FOLDS):
        model = fit([rig for i, rig in enumerate(rigs) if i % _FOLDS != fold])
        for rig in rigs[fold::_FOLDS]:
            for i, (scan, deviation) in enumerate(rig):
                others = [s for k, (s, _) in enumerate(rig) if k != i]
                for _ in range(3):
                    taken = random.choice(len(others), counted, replace=False)
                    posterior = model.posterior(
                        Reading(scan.height, scan.width, scan.log_gamma_estimated),
                        [others[k] for k in taken],
                    )
                    misses.append(scan.log_gamma_counted - posterior.mean)
                    scores.append(misses[-1] / np.hypot(posterior.std, deviation))
    return np.array(misses), np.array(scores)


def model_of(rigs: Rigs, title: str) -> GammaModel:
    """The model with its scores; prints its errors."""
    for counted in (1, 3):
        misses, scores = errors(rigs, counted)
        print(f"{title}: {len(rigs)} rigs, {counted} counted: mean error "
              f"{np.abs(np.expm1(misses)).mean():.3f}, median "
              f"{np.median(np.abs(np.expm1(misses))):.3f}, scores {scores.std():.2f}")
        if counted == 1:
            kept = np.quantile(scores, (np.arange(_SCORES) + 0.5) / _SCORES)
    every = fit(rigs)
    return GammaModel(**{**every.__dict__, "scores": kept})


def main() -> int:
    """Writes the file and prints the errors on rigs left out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scans", type=Path)
    parser.add_argument("--one-view", type=Path, required=True, metavar="DIR")
    parser.add_argument("--families", type=Path, required=True,
                        help="families.json of the run that the weights are from")
    parser.add_argument("--weights", type=Path,
                        default=Path(__file__).parents[1] / "weights" / "gamma.safetensors")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    checkpoint = load_members(options.weights)
    known = TrainingDomain(*(checkpoint.calibration[name]
                             for name in ("middle", "whiten", "reach")))
    fold = fold_of(json.loads(options.families.read_text()))
    models = []
    for folder, title, center in zip((options.scans, options.one_view), ("around", "one side"),
                                     checkpoint.calibration["centers"].tolist()):
        of = residuals(dict(enumerate(checkpoint.members)), read_scans(folder), fold, known)
        models.append(model_of(rigs_of(of, center), title))
        between, within = volume_errors(of)
        print(f"center {center:+.3f}, here {center_of(of):+.3f}; log V's error between rigs "
              f"{np.round(between, 5).tolist()}, standard deviation within {within:.3f}")
    PartModels(f"network {checkpoint.facts['version']}", *models,
               made="simulated rigs of training parts").write(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
