# SPDX-License-Identifier: Apache-2.0
"""What the scans of one part in one container have in common: `weights/parts.json`.

By it one counted bin corrects a part that has no CAD file. It is fitted on parts that the
estimator had not seen; docs/parts.md tells how SCANS and SINGLE, of `simulate --plan rig`, were
made.

    python -m stack_counter.train.parts SCANS --one-view SINGLE --families RUN/families.json \
        --out WEIGHTS

A mixed model (`parts.gamma_model`): the coefficients of 1 and of the height differ from rig to
rig, by a covariance that is found by maximum likelihood, as is the rest.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import minimize

from stack_counter.errors import ConfigError
from stack_counter.files import shipped_weights
from stack_counter.occupancy.checkpoint import load_members
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH
from stack_counter.occupancy.network import SHIPPED
from stack_counter.occupancy.training_domain import TrainingDomain
from stack_counter.occupancy.weights_file import knowing_name
from stack_counter.parts.gamma_model import FEATURES, GammaModel, Reading, fill_features
from stack_counter.parts.part_models import PartModels
from stack_counter.sim import SCENES_PER_RIG
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.data.fused import read_scans
from stack_counter.train.residuals import Residual, count_with_members, median_log_error
from stack_counter.types import KnownLevel

_SHARED = 2  # features whose coefficients differ from rig to rig: 1 and the height


@dataclass(frozen=True)
class PartModelSettings:
    """How the model is fitted and evaluated; all chosen.

    Attributes:
        folds: groups of rigs, each left out once for the scores.
        least_scans: scans that a rig must have.
        draws: sets of counted scans drawn for each scan that is left out.
        scores: number of scores stored, evenly spaced quantiles.
        largest_volume_error: log of measured over true V beyond which a container was missed.
        jitter: added to the variances, for the covariance to be positive.
    """

    folds: int = 6
    least_scans: int = 4
    draws: int = 3
    scores: int = 400
    largest_volume_error: float = 0.15
    jitter: float = 1e-8


SETTINGS = PartModelSettings()


@dataclass(frozen=True)
class RigScan:
    """One scan of a rig.

    Attributes:
        reading: size of the fill, true and estimated gamma.
        volume_deviation: relative standard deviation of V.
    """

    reading: Reading
    volume_deviation: float


@dataclass(frozen=True, eq=False)
class VolumeErrors:
    """Errors of log V.

    Attributes:
        between_rigs: (2, 2) covariance, between rigs, of the coefficients of 1 and of the height.
        within_rig: standard deviation within a rig.
    """

    between_rigs: np.ndarray
    within_rig: float


@dataclass(frozen=True, eq=False)
class LeftOutErrors:
    """Errors of log gamma on rigs left out, (n,), and the same in standard deviations."""

    log_errors: np.ndarray
    scores: np.ndarray


def group_by_rig(residuals: Sequence[Residual], center: float) -> list[list[RigScan]]:
    """Groups scans by rig: of the same run, container and part.

    Args:
        residuals: scans counted by members that had not seen their families.
        center: median log error of the estimator, which is taken out.
    """
    rigs = defaultdict(list)
    for r in residuals:
        if r.scan.found:
            log_true = np.log(r.scan.sample.gamma * r.scan.true_volume / r.scan.volume)
            reading = Reading(*_fill_size(r), np.log(r.gamma) + center, log_true)
            rigs[_rig_key(r)].append(RigScan(reading, r.scan.volume_std / r.scan.volume))
    return [rig for rig in rigs.values() if len(rig) >= SETTINGS.least_scans]


def fit_volume_errors(residuals: Sequence[Residual]) -> VolumeErrors:
    """Fits the errors of log V between and within rigs by maximum likelihood.

    Scans that are far off are left out: they have missed their container.
    """
    # Group errors and fill sizes by rig.
    rigs = defaultdict(list)
    for r in residuals:
        error = np.log(r.scan.volume / r.scan.true_volume)
        if r.scan.found and abs(error) < SETTINGS.largest_volume_error:
            rigs[_rig_key(r)].append((error, *_fill_size(r)))
    groups = [np.array(rig) for rig in rigs.values() if len(rig) >= SETTINGS.least_scans]
    data = [(g[:, 0], fill_features(g[:, 1], g[:, 2])[:, :_SHARED]) for g in groups]

    def cholesky_root(p: np.ndarray) -> np.ndarray:
        return np.array([[p[0], 0.0], [p[1], p[2]]])

    def negative_log_likelihood(p: np.ndarray) -> float:
        total = 0.0
        for error, x in data:
            covariance = x @ cholesky_root(p) @ cholesky_root(p).T @ x.T + p[3]**2 * np.eye(len(x))
            rest = error - x @ p[4:]
            total += np.linalg.slogdet(covariance)[1] + rest @ np.linalg.solve(covariance, rest)
        return float(total)

    # Parameters: root of the covariance (3), deviation within a rig, mean coefficients (2).
    p = minimize(negative_log_likelihood, [0.02, 0.0, 0.02, 0.02, 0.0, 0.0],
                 method="Nelder-Mead", options={"maxiter": 8000, "maxfev": 8000}).x
    return VolumeErrors(cholesky_root(p) @ cholesky_root(p).T, abs(float(p[3])))


class MixedModel(torch.nn.Module):
    """Parameters of the mixed model of true and estimated log gamma."""

    def __init__(self) -> None:
        """Begins with all coefficients 0."""
        super().__init__()
        def diagonal(n: int, value: float) -> torch.nn.Parameter:
            return torch.nn.Parameter(value * torch.eye(n, dtype=torch.double))
        self.coefficients = torch.nn.Parameter(torch.zeros(2, FEATURES, dtype=torch.double))
        self.shared_root, self.noise_root = diagonal(2 * _SHARED, 0.15), diagonal(2, 0.08)

    def negative_log_likelihood(self, features: torch.Tensor, values: torch.Tensor
                                ) -> torch.Tensor:
        """Negative log likelihood of a rig's (2 n,) values, features (n, FEATURES)."""
        both = torch.kron(torch.eye(2, dtype=torch.double), features[:, :_SHARED].contiguous())
        covariance = both @ self.shared() @ both.T \
            + torch.kron(self.noise(), torch.eye(len(features)).double())
        covariance = covariance + SETTINGS.jitter * torch.eye(len(covariance)).double()
        mean = (features @ self.coefficients.T).T.reshape(-1)
        return -torch.distributions.MultivariateNormal(mean, covariance).log_prob(values)

    def shared(self) -> torch.Tensor:
        """(4, 4) covariance of the coefficients between rigs."""
        return self.shared_root.tril() @ self.shared_root.tril().T

    def noise(self) -> torch.Tensor:
        """(2, 2) covariance of a scan's own errors."""
        return self.noise_root.tril() @ self.noise_root.tril().T


def fit_mixed_model(rigs: Sequence[Sequence[RigScan]]) -> GammaModel:
    """Fits the model by maximum likelihood; its scores are not set."""
    # Features and values of each rig.
    data = []
    for rig in rigs:
        readings = [scan.reading for scan in rig]
        x = fill_features(np.array([r.height for r in readings]),
                          np.array([r.width for r in readings]))
        values = np.array([[r.log_gamma_counted, r.log_gamma_estimated] for r in readings])
        data.append((torch.tensor(x), torch.tensor(values.T.ravel())))
    # Maximise the likelihood.
    model = MixedModel()
    optimizer = torch.optim.LBFGS(model.parameters(), max_iter=200,
                                  line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimizer.zero_grad()
        loss = torch.stack([model.negative_log_likelihood(x, values) for x, values in data]).mean()
        loss.backward()
        return loss

    optimizer.step(closure)
    # Coefficients that do not differ from rig to rig have no covariance.
    shared = np.zeros((2, FEATURES, 2, FEATURES))
    shared[:, :_SHARED, :, :_SHARED] = model.shared().detach().numpy().reshape(
        2, _SHARED, 2, _SHARED)
    scans = [scan for rig in rigs for scan in rig]
    return GammaModel(
        coefficients=model.coefficients.detach().numpy(),
        shared=shared.reshape(2 * FEATURES, 2 * FEATURES), noise=model.noise().detach().numpy(),
        volume_variance=float(np.mean([s.volume_deviation**2 for s in scans])),
        scores=np.zeros(1), least=np.array([min(s.reading.height for s in scans),
                                            min(s.reading.width for s in scans)]),
        friction=np.full(2, np.nan), source="training")


def left_out_errors(rigs: Sequence[Sequence[RigScan]], counted: int) -> LeftOutErrors:
    """Errors on rigs left out of the fit when `counted` other scans of theirs are counted."""
    random = np.random.default_rng(0)
    log_errors, scores = [], []
    for fold in range(SETTINGS.folds):
        model = fit_mixed_model([rig for i, rig in enumerate(rigs) if i % SETTINGS.folds != fold])
        for rig in rigs[fold::SETTINGS.folds]:
            for i, scan in enumerate(rig):
                others = [other.reading for k, other in enumerate(rig) if k != i]
                uncounted = Reading(scan.reading.height, scan.reading.width,
                                    scan.reading.log_gamma_estimated)
                for _ in range(SETTINGS.draws):
                    drawn = random.choice(len(others), counted, replace=False)
                    posterior = model.posterior(uncounted, [others[k] for k in drawn])
                    log_errors.append(scan.reading.log_gamma_counted - posterior.mean)
                    scores.append(log_errors[-1] / np.hypot(posterior.std, scan.volume_deviation))
    return LeftOutErrors(np.array(log_errors), np.array(scores))


def fit_with_scores(rigs: Sequence[Sequence[RigScan]], title: str) -> GammaModel:
    """Fits the model with its scores; prints its errors."""
    by_counted = {counted: left_out_errors(rigs, counted) for counted in (1, 3)}
    for counted, errors in by_counted.items():
        relative = np.abs(np.expm1(errors.log_errors))
        print(f"{title}: {len(rigs)} rigs, {counted} counted: mean error {relative.mean():.3f}, "
              f"median {np.median(relative):.3f}, scores {errors.scores.std():.2f}")
    shares = (np.arange(SETTINGS.scores) + 0.5) / SETTINGS.scores
    return replace(fit_mixed_model(rigs), scores=np.quantile(by_counted[1].scores, shares))


def _rig_key(residual: Residual) -> tuple[str, int, float]:
    """Seed of the run, number of the rig in it, and part length."""
    sample = residual.scan.sample
    seed, index = sample.name.split(":")
    return seed, int(index) // SCENES_PER_RIG, sample.part_length_m


def _fill_size(residual: Residual) -> tuple[float, float]:
    """Height and width of the fill in part lengths, as of a `Reading`."""
    sample = residual.scan.sample
    area = np.count_nonzero(sample.maps.valid) / PIXELS_PER_LENGTH**2
    return residual.scan.volume / sample.part_length_m**3 / area, float(np.sqrt(area))


def main() -> int:
    """Writes the file and prints the errors on rigs left out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scans", type=Path)
    parser.add_argument("--one-view", type=Path, required=True, metavar="DIR")
    parser.add_argument("--families", type=Path, required=True,
                        help="families.json of the run that the weights are from")
    parser.add_argument("--weights", type=Path, default=shipped_weights(SHIPPED))
    parser.add_argument("--level", choices=[level.name.lower() for level in KnownLevel],
                        default="volume", help="how much is known of the parts' form; of each "
                        "there is a file of its own")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    level = KnownLevel[options.level.upper()]
    checkpoint = load_members(options.weights)
    centers = np.atleast_2d(checkpoint.calibration["centers"])
    if level >= len(centers):
        raise ConfigError(f"--level {options.level}: {options.weights} knows v alone; expected "
                          "--level volume")
    domain = TrainingDomain(*(checkpoint.calibration[name]
                              for name in ("middle", "whiten", "reach")))
    fold = assign_folds(json.loads(options.families.read_text()))
    models = []
    for folder, title, center in zip((options.scans, options.one_view), ("around", "one side"),
                                     centers[level].tolist()):
        residuals = count_with_members(dict(enumerate(checkpoint.members)), read_scans(folder),
                                       fold, domain, level)
        models.append(fit_with_scores(group_by_rig(residuals, center), title))
        errors = fit_volume_errors(residuals)
        print(f"center {center:+.3f}, here {median_log_error(residuals):+.3f}; log V's error "
              f"between rigs {np.round(errors.between_rigs, 5).tolist()}, standard deviation "
              f"within {errors.within_rig:.3f}")
    PartModels(knowing_name(f"network {checkpoint.facts['version']}", level), *models,
               made="simulated rigs of training parts").write(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
