# SPDX-License-Identifier: Apache-2.0
"""Counts of truly fused scans by members that have not seen their families, and their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import nn

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import TorchEnsemble
from stack_counter.occupancy.known_form import hide_above
from stack_counter.occupancy.network import predict_gamma
from stack_counter.occupancy.training_domain import TrainingDomain, assess_doubt
from stack_counter.sim import source_of
from stack_counter.train.data.batches import fused_resolution
from stack_counter.train.data.fused import FusedScan
from stack_counter.types import KnownLevel


@dataclass(frozen=True)
class ResidualSettings:
    """Which groups of scans count; chosen.

    Attributes:
        min_group: fewest scans of a group, such as a source, that speaks for itself.
    """

    min_group: int = 10


SETTINGS = ResidualSettings()


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
