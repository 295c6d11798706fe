# SPDX-License-Identifier: Apache-2.0
"""Joins trained members to the file that is shipped, with their errors on families left out.

    python -m stack_counter.train.calibrate RUN --scans SCANS --one-view SINGLE \
        --pictures PICTURES --out WEIGHTS

Each truly fused scan is counted by the one member that never saw its family; the scores are of the
whole count, gamma and V together. With `--unseen-scans DIR` they are narrowed by what members gain
from counting together.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import save_members
from stack_counter.occupancy.gamma_net import knows_form
from stack_counter.occupancy.maps import surface_features
from stack_counter.occupancy.training_domain import TrainingDomain
from stack_counter.sim import source_of
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.data.fused import FusedScan, read_scans
from stack_counter.train.member import read_member
from stack_counter.train.onnx_export import export_ensemble
from stack_counter.train.residuals import SETTINGS as RESIDUALS
from stack_counter.train.residuals import (
    Residual,
    count_with_members,
    ensemble_narrowing,
    median_log_error,
    scores_where_found,
    summarize_all_errors,
    summarize_errors,
)
from stack_counter.types import KnownLevel


@dataclass(frozen=True)
class CalibrationSettings:
    """How the training domain is bounded; all chosen.

    Attributes:
        domain_share: share of the training stacks that lie within the domain's reach.
        variance_floor: added to the variances of the features.
    """

    domain_share: float = 0.99
    variance_floor: float = 1e-2


SETTINGS = CalibrationSettings()


def fit_training_domain(scans: list[FusedScan]) -> TrainingDomain:
    """Fits the distribution of the surfaces of scans."""
    features = np.array(
        [surface_features(s.sample.maps) for s in scans if s.sample.maps.height.any()])
    middle = features.mean(axis=0)
    values, vectors = np.linalg.eigh(
        np.cov(features.T) + SETTINGS.variance_floor * np.eye(features.shape[1]))
    whiten = vectors / np.sqrt(values)
    reach = np.quantile(np.linalg.norm((features - middle) @ whiten, axis=1),
                        SETTINGS.domain_share)
    return TrainingDomain(middle, whiten, np.array([reach]))


def main() -> int:
    """Writes the weights file and prints the errors."""
    options = _parse_arguments()
    # Load the members, and the scans that none of them has learnt from.
    paths = sorted(options.run.glob("member_*.pt"))
    if not paths:
        raise ConfigError(f"no member_*.pt in {options.run}; expected those that train writes")
    members = {int(path.stem.partition("_")[2]): read_member(path, options.encoder_weights)[0]
               for path in paths}
    fold = assign_folds(json.loads((options.run / "families.json").read_text()))
    groups = {"": read_scans(options.scans), "_one_side": read_scans(options.one_view)}
    if options.pictures is not None:
        groups["_pictures"] = read_scans(options.pictures)
    unseen = [] if options.unseen_scans is None else _read_unseen_scans(options.unseen_scans, fold)
    # Measure their errors.
    domain = fit_training_domain(groups[""] + groups["_one_side"])
    levels = list(KnownLevel) if knows_form(next(iter(members.values()))) else [KnownLevel.VOLUME]
    residuals = {suffix: [count_with_members(members, scans, fold, domain, level)
                          for level in levels] for suffix, scans in groups.items()}
    narrowing = [ensemble_narrowing(list(members.values()), unseen, domain, level)
                 if unseen else 1.0 for level in levels]
    calibration = {
        # What members gain together is measured on arcs, and applied to no other scans.
        **{f"scores{suffix}": np.array([(1.0 if suffix else factor) * scores_where_found(r)
                                        for factor, r in zip(narrowing, by_level)])
           for suffix, by_level in residuals.items()},
        "centers": np.array([[median_log_error(r) for r in by_level]
                             for by_level in residuals.values()]).T,
        **asdict(domain)}
    errors = {level.name.lower(): summarize_all_errors(
        {suffix: by_level[i] for suffix, by_level in residuals.items()})
        for i, level in enumerate(levels)}
    # Write.
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True,
                            text=True, check=False).stdout.strip()
    facts = {"version": options.version, "commit": commit, "errors": json.dumps(errors),
             "folds": json.dumps(list(members)), "narrowing": json.dumps(narrowing)}
    nets = list(members.values())
    graph = export_ensemble(nets) if options.encoder_weights is None else None
    save_members(options.out, nets, facts, calibration, graph)
    print(json.dumps({"errors": errors, "narrowing": narrowing}, indent=2))
    _print_groups(residuals[""], levels, lambda r: r.scan.sample.container_kind)
    _print_groups(residuals[""], levels, lambda r: source_of(r.scan.sample.family) or "own")
    return 0


def _read_unseen_scans(folder: Path, fold: dict[str, int]) -> list[FusedScan]:
    """Reads scans of parts that are in no fold.

    Raises:
        ConfigError: some are, so that members have learnt from them.
    """
    scans = read_scans(folder)
    if known := sorted({scan.sample.family for scan in scans} & fold.keys()):
        raise ConfigError(f"--unseen-scans {folder} shows {known[0]}, and {len(known) - 1} others "
                          "that members have learnt from; expected parts that none of them has "
                          "seen")
    return scans


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="folder of member_*.pt")
    parser.add_argument("--scans", type=Path, required=True)
    parser.add_argument("--one-view", type=Path, required=True, metavar="DIR",
                        help="scans of one view each, for stacks that are seen from one side")
    parser.add_argument("--pictures", type=Path, metavar="DIR",
                        help="scans of pictures without depth (train.scans --pictures)")
    parser.add_argument("--unseen-scans", type=Path, metavar="DIR",
                        help="scans from around of parts that no member has seen: how much"
                        " narrower the interval of all members together is than that of one")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--encoder-weights", type=Path, metavar="DIR", help="of DINOv2")
    parser.add_argument("--version", default="1", help="version that every count names")
    return parser.parse_args()


def _print_groups(by_level: list[list[Residual]], levels: list[KnownLevel],
                  group_of: Callable[[Residual], str]) -> None:
    """Prints a line for each level and group, of scans whose container was found."""
    for level, residuals in zip(levels, by_level):
        for group in sorted({group_of(r) for r in residuals}):
            found = [r for r in residuals if group_of(r) == group and r.scan.found]
            if len(found) < RESIDUALS.min_group:
                continue
            e = summarize_errors(found)
            print(f"{level.name.lower():7}{group:16}{len(found):5} gamma MAE "
                  f"{e['gamma_mae']:.3f} bias {e['gamma_bias']:+.3f} R2 {e['gamma_r2']:.2f}, "
                  f"count {e['count_mean_relative_error']:.3f}")


if __name__ == "__main__":
    sys.exit(main())
