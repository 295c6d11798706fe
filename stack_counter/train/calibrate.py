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
from torch import nn

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import TorchEnsemble, save_members
from stack_counter.occupancy.gamma_net import knows_form
from stack_counter.occupancy.known_form import hide_above
from stack_counter.occupancy.maps import surface_features
from stack_counter.occupancy.network import predict_gamma
from stack_counter.occupancy.training_domain import TrainingDomain, assess_doubt
from stack_counter.sim import source_of
from stack_counter.train.data.batches import assign_folds, fused_resolution
from stack_counter.train.data.fused import FusedScan, read_scans
from stack_counter.train.member import read_member
from stack_counter.train.onnx_export import export_ensemble
from stack_counter.types import KnownLevel


@dataclass(frozen=True)
class CalibrationSettings:
    """How the training domain is bounded, and which groups count; all chosen.

    Attributes:
        domain_share: share of the training stacks that lie within the domain's reach.
        variance_floor: added to the variances of the features.
        min_group: fewest scans of a group, such as a source, that speaks for itself.
    """

    domain_share: float = 0.99
    variance_floor: float = 1e-2
    min_group: int = 10


SETTINGS = CalibrationSettings()


@dataclass(frozen=True, eq=False)
class Residual:
    """One scan, counted by a member that had not seen its family.

    Attributes:
        scan: with its truth.
        gamma: as predicted.
        log_count_ratio: log of true over estimated count.
        relative_std: standard deviation of the count over the count, as predicted.
    """

    scan: FusedScan
    gamma: float
    log_count_ratio: float
    relative_std: float


def count_with_members(members: dict[int, nn.Module], scans: list[FusedScan],
                       fold: dict[str, int], domain: TrainingDomain,
                       level: KnownLevel = KnownLevel.VOLUME) -> list[Residual]:
    """Counts all scans of whose fold there is a member, doubted as at run time.

    Args:
        members: networks by the fold that they have not seen.
        scans: with truth.
        fold: of each family.
        domain: what the members have learnt from.
        level: how much is known of the parts' form.
    """
    residuals = []
    for scan in scans:
        net = members.get(fold[scan.sample.family])
        if net is not None and is_countable(scan):
            residuals.append(count_scan([net], scan, domain, level))
    return residuals


def is_countable(scan: FusedScan) -> bool:
    """Whether a scan shows a stack at all."""
    return bool(scan.volume > 0 and scan.sample.maps.height.any())


def count_scan(nets: list[nn.Module], scan: FusedScan, domain: TrainingDomain,
               level: KnownLevel) -> Residual:
    """Counts a scan with networks as the run time does, and compares gamma and V together."""
    sample = scan.sample
    prediction = predict_gamma(TorchEnsemble(nets), sample.maps, hide_above(sample.known, level),
                               fused_resolution(sample))
    gamma = float(np.exp(prediction.log_gamma))
    doubt = assess_doubt(
        sample.maps, parts=gamma * scan.volume / sample.part_length_m**3,
        part_size=float(np.exp(prediction.shape_logs[0])),
        walled=sample.container_kind != "none", domain=domain)
    log_ratio = np.log(sample.gamma) - prediction.log_gamma + np.log(
        scan.true_volume / scan.volume)
    return Residual(scan, gamma, float(log_ratio), float(np.hypot(
        prediction.relative_std * doubt.widening, scan.volume_std / scan.volume)))


def ensemble_narrowing(members: list[nn.Module], scans: list[FusedScan], domain: TrainingDomain,
                       level: KnownLevel) -> float:
    """How much smaller the scores of all members together are than those of one, at most 1.

    Members are measured one by one on families that each has not seen, and count together at run
    time, where what they do not share averages out. The root mean square of scores is compared:
    it listens to large errors, which bound an interval, and takes fewer scans than a quantile.

    Args:
        members: all networks.
        scans: of parts that none of them has seen.
        domain: what the members have learnt from.
        level: how much is known of the parts' form.

    Raises:
        ConfigError: none of the scans shows a stack in a container that was found.
    """
    shown = [scan for scan in scans if scan.found and is_countable(scan)]
    if not shown:
        raise ConfigError(f"none of {len(scans)} scans of unseen parts shows a stack whose "
                          "container was found; expected some tens")
    alone = [scores_where_found([count_scan([net], scan, domain, level) for scan in shown])
             for net in members]
    together = scores_where_found([count_scan(members, scan, domain, level) for scan in shown])
    return min(float(np.sqrt(np.mean(together**2) / np.mean(np.square(alone)))), 1.0)


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


def median_log_error(residuals: list[Residual]) -> float:
    """Log of true over predicted gamma of parts of any origin, of scans with a container found.

    What members predict for families that they have not seen is corrected by it. It is the median
    over sources of each one's median, so that no large collection speaks for the others; of all
    scans where no source has enough.
    """
    by_source: dict[str, list[float]] = {}
    for r in residuals:
        if r.scan.found:
            by_source.setdefault(source_of(r.scan.sample.family), []).append(
                float(np.log(r.scan.sample.gamma / r.gamma)))
    medians = [float(np.median(errors)) for errors in by_source.values()
               if len(errors) >= SETTINGS.min_group]
    return float(np.median(medians or sum(by_source.values(), [])))


def scores_where_found(residuals: list[Residual]) -> np.ndarray:
    """(n,) sorted errors after that correction, in the standard deviations predicted for them.

    They are of scans whose container was found.
    """
    center = median_log_error(residuals)
    return np.sort([(r.log_count_ratio - center) / r.relative_std for r in residuals
                    if r.scan.found])


def summarize_errors(residuals: list[Residual]) -> dict[str, float]:
    """Errors of gamma and of the count on families left out."""
    true = np.array([r.scan.sample.gamma for r in residuals])
    gamma = np.array([r.gamma for r in residuals])
    count_errors = np.exp(-np.array([r.log_count_ratio for r in residuals])) - 1
    return {"scans": len(residuals), "gamma_mae": float(np.abs(gamma - true).mean()),
            "gamma_bias": float((gamma - true).mean()),
            "gamma_r2": float(1 - ((gamma - true) ** 2).mean() / true.var()),
            "count_mean_relative_error": float(np.abs(count_errors).mean()),
            "count_median_relative_error": float(np.median(np.abs(count_errors)))}


def summarize_all_errors(residuals: dict[str, list[Residual]]) -> dict[str, float]:
    """Errors of all scans from around, and of those whose container was found, however seen.

    Args:
        residuals: by how the stacks were seen: "" from around, "_one_side", "_pictures".
    """
    metrics = summarize_errors(residuals[""])
    for suffix, group in residuals.items():
        found = summarize_errors([r for r in group if r.scan.found])
        metrics |= {f"{name}{suffix or '_found'}": x for name, x in found.items()}
    return {name: round(value, 4) for name, value in metrics.items()}


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
            if len(found) < SETTINGS.min_group:
                continue
            e = summarize_errors(found)
            print(f"{level.name.lower():7}{group:16}{len(found):5} gamma MAE "
                  f"{e['gamma_mae']:.3f} bias {e['gamma_bias']:+.3f} R2 {e['gamma_r2']:.2f}, "
                  f"count {e['count_mean_relative_error']:.3f}")


if __name__ == "__main__":
    sys.exit(main())
