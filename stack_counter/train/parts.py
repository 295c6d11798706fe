# SPDX-License-Identifier: Apache-2.0
r"""Fits what the scans of one part in one container have in common: `weights/parts.json`.

By it one counted bin corrects a part that has no CAD file. The parts are ones that the estimator
had not seen; docs/parts.md says how SCANS and SINGLE, of `simulate --plan rig`, were made.

    python -m stack_counter.train.parts SCANS --one-view SINGLE --families RUN/families.json \
        --out WEIGHTS

A mixed model (`GammaModel`): the coefficients of 1 and of the height differ from rig to rig, by a
covariance that is found by maximum likelihood, as is the rest.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from dataclasses import dataclass
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
from stack_counter.train.calibrate import Residual, count_with_members, median_log_error
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.data.fused import read_scans

# Coefficients that differ from rig to rig: those of 1 and of the height.
_SHARED = 2
# The readings of each rig, with V's relative standard deviation.
Rigs = list[list[tuple[Reading, float]]]


@dataclass(frozen=True)
class MixedModelSettings:
    """How the mixed model is fitted and scored; chosen.

    Attributes:
        folds: parts of the rigs that are left out in turn.
        min_scans: fewest scans of a rig that is used.
        scores: number of scores that are kept, evenly spaced quantiles.
        max_volume_error: largest relative error of V of a scan whose container was found.
        draws: random choices of counted scans for each scan that is left out.
    """

    folds: int = 6
    min_scans: int = 4
    scores: int = 400
    max_volume_error: float = 0.15
    draws: int = 3


SETTINGS = MixedModelSettings()


def group_by_rig(residuals: list[Residual], center: float) -> Rigs:
    """Groups the scans whose container was found by rig: run, container and part."""
    rigs = defaultdict(list)
    for r in residuals:
        if r.scan.found:
            true = np.log(r.scan.sample.gamma * r.scan.true_volume / r.scan.volume)
            rigs[_rig_key(r)].append((Reading(*_fill_size(r), np.log(r.gamma) + center, true),
                                  r.scan.volume_std / r.scan.volume))
    return [rig for rig in rigs.values() if len(rig) >= SETTINGS.min_scans]


def _rig_key(residual: Residual) -> tuple[str, int, float]:
    sample = residual.scan.sample
    seed, index = sample.name.split(":")
    return seed, int(index) // SCENES_PER_RIG, sample.length_m


def _fill_size(residual: Residual) -> tuple[float, float]:
    """Returns height and width of the fill, in part lengths."""
    sample = residual.scan.sample
    area = np.count_nonzero(sample.maps.valid) / PIXELS_PER_LENGTH**2
    return residual.scan.volume / sample.length_m**3 / area, float(np.sqrt(area))


def fit_volume_errors(residuals: list[Residual]) -> tuple[np.ndarray, float]:
    """Fits the error of log V by maximum likelihood.

    Scans that are farther off than 15% have missed their container and are left out.

    Returns:
        Covariance (2, 2) between rigs of the coefficients of 1 and 1 / (h + 1/2), and the standard
        deviation within them.
    """
    rigs = defaultdict(list)
    for r in residuals:
        error = np.log(r.scan.volume / r.scan.true_volume)
        if r.scan.found and abs(error) < SETTINGS.max_volume_error:
            rigs[_rig_key(r)].append((error, *_fill_size(r)))
    groups = [np.array(rig) for rig in rigs.values() if len(rig) >= SETTINGS.min_scans]
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


class MixedModel(torch.nn.Module):
    """The mixed model's parameters."""

    def __init__(self) -> None:
        """Starts from small independent deviations."""
        super().__init__()

        def square(n: int, size: float) -> torch.nn.Parameter:
            return torch.nn.Parameter(size * torch.eye(n, dtype=torch.double))

        self.coefficients = torch.nn.Parameter(torch.zeros(2, FEATURES, dtype=torch.double))
        self.shared, self.noise = square(2 * _SHARED, 0.15), square(2, 0.08)

    def negative_log_likelihood(self, features: torch.Tensor, values: torch.Tensor
                                ) -> torch.Tensor:
        """Computes the negative log likelihood of the (2 n,) values of a rig.

        `features`: (n, FEATURES), of its scans.
        """
        both = torch.kron(torch.eye(2, dtype=torch.double), features[:, :_SHARED].contiguous())
        shared, noise = (a.tril() @ a.tril().T for a in (self.shared, self.noise))
        covariance = both @ shared @ both.T + torch.kron(noise, torch.eye(len(features)).double())
        covariance = covariance + 1e-8 * torch.eye(len(covariance)).double()
        mean = (features @ self.coefficients.T).T.reshape(-1)
        return -torch.distributions.MultivariateNormal(mean, covariance).log_prob(values)


def fit_mixed_model(rigs: Rigs) -> GammaModel:
    """Fits the model of maximum likelihood; its scores are left empty."""
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
    net = MixedModel()
    steps = torch.optim.LBFGS(net.parameters(), max_iter=200, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        steps.zero_grad()
        loss = torch.stack([net.negative_log_likelihood(x, values) for x, values in data]).mean()
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


def measure_left_out_errors(rigs: Rigs, counted: int) -> tuple[np.ndarray, np.ndarray]:
    """Measures the log errors of scans of rigs that the fit left out.

    Args:
        rigs: all rigs.
        counted: number of other scans of the same rig that are counted.

    Returns:
        The errors, and the same in standard deviations.
    """
    random = np.random.default_rng(0)
    errors, scores = [], []
    for fold in range(SETTINGS.folds):
        model = fit_mixed_model([rig for i, rig in enumerate(rigs) if i % SETTINGS.folds != fold])
        for rig in rigs[fold::SETTINGS.folds]:
            for i, (scan, deviation) in enumerate(rig):
                others = [s for k, (s, _) in enumerate(rig) if k != i]
                for _ in range(SETTINGS.draws):
                    taken = random.choice(len(others), counted, replace=False)
                    posterior = model.posterior(
                        Reading(scan.height, scan.width, scan.log_gamma_estimated),
                        [others[k] for k in taken],
                    )
                    errors.append(scan.log_gamma_counted - posterior.mean)
                    scores.append(errors[-1] / np.hypot(posterior.std, deviation))
    return np.array(errors), np.array(scores)


def fit_scored_model(rigs: Rigs, title: str) -> GammaModel:
    """Fits the model with its scores, and prints its errors."""
    for counted in (1, 3):
        errors, scores = measure_left_out_errors(rigs, counted)
        print(f"{title}: {len(rigs)} rigs, {counted} counted: mean error "
              f"{np.abs(np.expm1(errors)).mean():.3f}, median "
              f"{np.median(np.abs(np.expm1(errors))):.3f}, scores {scores.std():.2f}")
        if counted == 1:
            kept = np.quantile(scores, (np.arange(SETTINGS.scores) + 0.5) / SETTINGS.scores)
    every = fit_mixed_model(rigs)
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
    fold = assign_folds(json.loads(options.families.read_text()))
    models = []
    for folder, title, center in zip((options.scans, options.one_view), ("around", "one side"),
                                     checkpoint.calibration["centers"].tolist()):
        residuals = count_with_members(
            dict(enumerate(checkpoint.members)), read_scans(folder), fold, known
        )
        models.append(fit_scored_model(group_by_rig(residuals, center), title))
        between, within = fit_volume_errors(residuals)
        print(f"center {center:+.3f}, here {median_log_error(residuals):+.3f}; log V's error "
              f"between rigs {np.round(between, 5).tolist()}, standard deviation within "
              f"{within:.3f}")
    PartModels(f"network {checkpoint.facts['version']}", *models,
               made="simulated rigs of training parts").write(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
