# SPDX-License-Identifier: Apache-2.0
"""Joins trained members to the file that is shipped, with their errors on unseen families.

    python -m stack_counter.train.calibrate RUN --scans SCANS --one-view SINGLE --out WEIGHTS

Each truly fused scan is counted by the one member that never saw its family; the scores are of the
whole count, gamma and V together.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from torch import nn

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import save_members
from stack_counter.occupancy.maps import surface_features
from stack_counter.occupancy.network import predict_gamma
from stack_counter.occupancy.training_domain import TrainingDomain, assess_doubt
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.data.fused import FusedScan, read_scans
from stack_counter.train.gamma import read_member


@dataclass(frozen=True)
class CalibrationSettings:
    """How the domain of training is described; chosen.

    Attributes:
        known_share: share of the training stacks that lie within the domain.
        covariance_floor: added to the variances of the surface features.
    """

    known_share: float = 0.99
    covariance_floor: float = 1e-2


SETTINGS = CalibrationSettings()


@dataclass(frozen=True, eq=False)
class Residual:
    """One scan, counted by a member that had not seen its family.

    Attributes:
        scan: the scan.
        gamma: estimated occupancy ratio.
        log_count: log of true over estimated count.
        spread: relative standard deviation that was predicted for the count.
    """

    scan: FusedScan
    gamma: float
    log_count: float
    spread: float


def count_with_members(members: dict[int, nn.Module], scans: list[FusedScan], fold: dict[str, int],
              known: TrainingDomain) -> list[Residual]:
    """Counts the scans whose fold has a member, with the doubts of the run time."""
    out = []
    for scan in scans:
        net = members.get(fold[scan.sample.family])
        if net is None or not scan.volume > 0 or not scan.sample.maps.height.any():
            continue
        sample = scan.sample
        prediction = predict_gamma([net], sample.maps)
        gamma = float(np.exp(prediction.log_gamma))
        doubt = assess_doubt(sample.maps, gamma * scan.volume / sample.length_m**3,
                             float(np.exp(prediction.shape_logs[0])), sample.kind != "none",
                             known)
        miss = np.log(sample.gamma) - prediction.log_gamma + np.log(
            scan.true_volume / scan.volume)
        out.append(Residual(scan, gamma, float(miss), float(np.hypot(
            prediction.relative_std * doubt.widening, scan.volume_std / scan.volume))))
    return out


def fit_training_domain(scans: list[FusedScan]) -> TrainingDomain:
    """Fits the domain of training: mean, whitening and reach of the surface features."""
    features = np.array(
        [surface_features(s.sample.maps) for s in scans if s.sample.maps.height.any()]
    )
    middle = features.mean(axis=0)
    values, vectors = np.linalg.eigh(
        np.cov(features.T) + SETTINGS.covariance_floor * np.eye(features.shape[1])
    )
    whiten = vectors / np.sqrt(values)
    reach = np.quantile(np.linalg.norm((features - middle) @ whiten, axis=1), SETTINGS.known_share)
    return TrainingDomain(middle, whiten, np.array([reach]))


def median_log_error(residuals: list[Residual]) -> float:
    """Returns the median log of true over estimated gamma, where the container was found.

    Estimates of families that a member has not seen are corrected by it.
    """
    return float(
        np.median([np.log(r.scan.sample.gamma / r.gamma) for r in residuals if r.scan.found])
    )


def scores_where_found(residuals: list[Residual]) -> np.ndarray:
    """Returns the (n,) sorted errors after the median's correction, where the container was found.

    They are in the standard deviations that were predicted for them.
    """
    center = median_log_error(residuals)
    return np.sort([(r.log_count - center) / r.spread for r in residuals if r.scan.found])


def summarize_errors(residuals: list[Residual]) -> dict[str, float]:
    """Summarizes the errors of gamma and of the count on families left out."""
    true = np.array([r.scan.sample.gamma for r in residuals])
    guess = np.array([r.gamma for r in residuals])
    count = np.exp(-np.array([r.log_count for r in residuals])) - 1
    return {"scans": len(residuals), "gamma_mae": float(np.abs(guess - true).mean()),
            "gamma_bias": float((guess - true).mean()),
            "gamma_r2": float(1 - ((guess - true) ** 2).mean() / true.var()),
            "count_mean_relative_error": float(np.abs(count).mean()),
            "count_median_relative_error": float(np.median(np.abs(count)))}


def main() -> int:
    """Writes the weights file and prints the errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="folder of member_*.pt")
    parser.add_argument("--scans", type=Path, required=True)
    parser.add_argument("--one-view", type=Path, required=True, metavar="DIR",
                        help="scans of one view each, for stacks that are seen from one side")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--encoder-weights", type=Path, metavar="DIR", help="of DINOv2")
    parser.add_argument("--version", default="1", help="version that every count names")
    options = parser.parse_args()
    paths = sorted(options.run.glob("member_*.pt"))
    if not paths:
        raise ConfigError(f"no member_*.pt in {options.run}; expected those that train writes")
    members = {int(path.stem.partition("_")[2]): read_member(path, options.encoder_weights)[0]
               for path in paths}
    scans = read_scans(options.scans)
    families = json.loads((options.run / "families.json").read_text())
    single = read_scans(options.one_view)
    known, fold = fit_training_domain(scans + single), assign_folds(families)
    from_arc, from_one_view = (
        count_with_members(members, group, fold, known) for group in (scans, single)
    )
    tensors = {
        "scores": scores_where_found(from_arc),
        "scores_one_side": scores_where_found(from_one_view),
        "centers": np.array([median_log_error(from_arc), median_log_error(from_one_view)]),
        **asdict(known),
    }
    found = {
        f"{k}_found": v for k, v in summarize_errors([r for r in from_arc if r.scan.found]).items()
    }
    one = {
        f"{k}_one_view": v
        for k, v in summarize_errors([r for r in from_one_view if r.scan.found]).items()
    }
    errors = {k: round(v, 4) for k, v in {**summarize_errors(from_arc), **found, **one}.items()}
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True,
                            text=True, check=False).stdout.strip()
    facts = {"version": options.version, "commit": commit, "errors": json.dumps(errors)}
    save_members(options.out, list(members.values()), facts, tensors)
    print(json.dumps(errors, indent=2))
    for name in sorted({r.scan.sample.kind for r in from_arc}):
        group = [r for r in from_arc if r.scan.sample.kind == name and r.scan.found]
        if group:
            e = summarize_errors(group)
            print(f"{name:10}{len(group):5} gamma MAE {e['gamma_mae']:.3f} bias "
                  f"{e['gamma_bias']:+.3f} R2 {e['gamma_r2']:.2f}, count "
                  f"{e['count_mean_relative_error']:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
