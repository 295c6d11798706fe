# SPDX-License-Identifier: Apache-2.0
"""Fits the numbers of `VolumeModel` to scans of training scenes, with bootstrapped errors.

Bias is fitted so that V agrees with the truth, a standard deviation as the size within which 68%
of the errors lie; neither is moved by one scan gone wrong. No fit is bounded below, so that the
bootstrap shows how little is known of a number near 0; what the run time uses is 0 or more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy import optimize

from stack_counter.fusion.volume_model import VolumeModel
from stack_counter.train.data.volume_errors import ARC, ONE_SIDE, PICTURES, VolumeErrors


@dataclass(frozen=True)
class FitSettings:
    """How the numbers are fitted; all chosen.

    Attributes:
        sigma_share: share of a normal distribution within one standard deviation.
        usual_error: relative error of V beyond which a scan counts less than by least squares.
        min_filled_in: volume filled in, relative to V, from which a scan says something of its
            error.
        bootstrap_draws: number of samples of the scenes that give the standard errors.
        min_scans: number of scans below which a number is not measured.
    """

    sigma_share: float = 0.6827
    usual_error: float = 0.03
    min_filled_in: float = 0.02
    bootstrap_draws: int = 200
    min_scans: int = 4


SETTINGS = FitSettings()
Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class MeasuredNumber:
    """One number of the model as measured.

    Attributes:
        measured: the number, in its unit; a standard deviation is below 0 where the other errors
            of V explain more than there is.
        std_error: standard error of it, by drawing scenes again with replacement.
        scans: number of scans that it rests on.
    """

    measured: float
    std_error: float
    scans: int


def measure_numbers(errors: Sequence[VolumeErrors], shipped: VolumeModel, seed: int = 0
                    ) -> dict[str, MeasuredNumber]:
    """Fits every number that enough scans say something of.

    Args:
        errors: of the scans.
        shipped: model that the scans were measured with; its numbers stand in for those that
            too few scans say something of.
        seed: seed of the bootstrap.
    """
    random, scenes = np.random.default_rng(seed), sorted({e.scene for e in errors})
    of_scene: dict[str, list[VolumeErrors]] = {name: [] for name in scenes}
    for error in errors:
        of_scene[error.scene].append(error)
    # Fit to all scenes, then to scenes drawn with replacement.
    fitted, scans = fit_numbers(errors, shipped)
    draws = [fit_numbers([e for i in random.integers(len(scenes), size=len(scenes))
                          for e in of_scene[scenes[i]]], shipped)[0]
             for _ in range(SETTINGS.bootstrap_draws)]
    # Standard errors by half the width of the middle 68%.
    out = {}
    for name, value in fitted.items():
        again = [draw[name] for draw in draws if name in draw]
        low, high = np.quantile(again, [0.5 - SETTINGS.sigma_share / 2,
                                        0.5 + SETTINGS.sigma_share / 2])
        out[name] = MeasuredNumber(value, float(high - low) / 2, scans[name])
    return out


def fit_numbers(errors: Iterable[VolumeErrors], shipped: VolumeModel
                ) -> tuple[dict[str, float], dict[str, int]]:
    """Fits the numbers of the model.

    Args:
        errors: of the scans.
        shipped: model that the scans were measured with.

    Returns:
        The numbers that enough scans say something of, and how many scans each rests on.
    """
    fitted: dict[str, float] = {}
    scans: dict[str, int] = {}
    errors = list(errors)

    def fit(names: str, chosen: Sequence[VolumeErrors], *needed: str,
            by: Callable[[Columns], Sequence[float]]) -> None:
        """Fits numbers to the chosen scans in which all needed quantities were measured."""
        columns = {f.name: np.array([getattr(e, f.name) for e in chosen])
                   for f in fields(VolumeErrors)}
        usable = np.ones(len(chosen), bool)
        for name in needed:
            usable &= np.isfinite(columns[name].astype(float))
        if np.count_nonzero(usable) < SETTINGS.min_scans:
            return
        values = by({name: column[usable] for name, column in columns.items()})
        for name, value in zip(names.split(), values):
            fitted[name], scans[name] = float(value), int(np.count_nonzero(usable))

    def model() -> VolumeModel:
        """The numbers fitted so far, the others as shipped."""
        return replace(shipped, **fitted)

    # Bias: V of arcs, then of one view with the same worn height.
    arcs = [e for e in errors if e.views == ARC]
    quiet = [e for e in arcs if e.noise_factor == 1]
    fit("hidden_share worn_height_m", quiet, "seen_fill", by=_fit_bias)
    one_side = [e for e in errors if e.views == ONE_SIDE and e.noise_factor == 1]
    for name, is_heap in (("hidden_share_one_side", False), ("hidden_share_one_side_heap", True)):
        fit(name, [e for e in one_side if e.is_heap == is_heap], "seen_fill",
            by=lambda c: [_fit_hidden_share(c, model().worn_height_m)])
    # Errors that the true surface and container show directly.
    fit("level_std_m level_std_per_noise", arcs, "crest_worn", by=_fit_level_std)
    fit("wall_std_m", quiet, "wall_offset", by=lambda c: [_spread(c["wall_offset"])])
    fit("floor_std_per_wall", quiet, "floor_error",
        by=lambda c: [_spread(c["floor_error"] / c["assumed_floor"])])
    fit("filled_in_std", [e for e in quiet if e.hidden_fill > SETTINGS.min_filled_in * e.volume],
        "hidden_fill", by=lambda c: [_fit_filled_in_std(c)])
    # What is left of V's error: in containers, then of heaps, then of depth from pictures.
    for name, is_heap in (("volume_std", False), ("heap_std", True)):
        without = replace(model(), **{name: 0.0})
        chosen = [e for e in quiet if e.is_heap == is_heap and np.isfinite(e.seen_fill)]
        fit(name, chosen, by=lambda c, m=without, s=chosen: [_fit_rest_of_error(s, m)])
    pictures = [e for e in errors if e.views == PICTURES]
    fit("stereo_std", pictures, by=lambda c: [_fit_stereo_std(c, shipped)])
    # The rim's width as one camera above measures it.
    fit("lost_rim_width_m lost_rim_width_per_noise lost_rim_width_std",
        [e for e in errors if e.views == ONE_SIDE], "lost_rim_width", by=_fit_lost_rim_width)
    return fitted, scans


def _fit_bias(c: Columns) -> Sequence[float]:
    """Hidden share and worn height that give the true V, by robust least squares."""
    rows = np.stack([c["hidden_fill"], c["area"]], axis=1) / c["true_volume"][:, None]
    return _robust_least_squares(rows, 1 - c["seen_fill"] / c["true_volume"])


def _fit_hidden_share(c: Columns, worn_height_m: float) -> float:
    """The hidden share alone that gives the true V, by robust least squares."""
    missing = c["true_volume"] - c["seen_fill"] - worn_height_m * c["area"]
    rows = c["hidden_fill"][:, None] / c["true_volume"][:, None]
    return float(_robust_least_squares(rows, missing / c["true_volume"])[0])


def _robust_least_squares(rows: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Coefficients of a linear model of V's relative error, by the soft L1 loss."""
    first = np.linalg.lstsq(rows, target, rcond=None)[0]
    scale = np.maximum(np.abs(rows).max(axis=0), 1e-9)
    return optimize.least_squares(lambda x: (rows / scale) @ x - target, first * scale,
                                  loss="soft_l1", f_scale=SETTINGS.usual_error).x / scale


def _fit_level_std(c: Columns) -> Sequence[float]:
    """Spread of the crests' level, and what each metre of the depth's noise adds to it."""
    off = np.abs(c["crest_worn"] - np.median(c["crest_worn"]))
    return _quantile_line(c["depth_noise_m"], off, SETTINGS.sigma_share)


def _fit_filled_in_std(c: Columns) -> float:
    """Spread of the true volume where no view saw, relative to what is filled in without bias."""
    ratio = c["true_hidden_fill"] / c["hidden_fill"]
    return _spread(ratio / np.median(ratio) - 1)


def _fit_rest_of_error(scans: Sequence[VolumeErrors], without: VolumeModel) -> float:
    """Relative error of V that makes 68% of all errors lie within one standard deviation.

    Args:
        scans: whose V is corrected by the model.
        without: model without the error that is fitted.
    """
    volume = np.array([e.corrected_volume(without.hidden_share, without.worn_height_m)
                       for e in scans])
    error = volume - [e.true_volume for e in scans]
    explained = np.array([e.volume_std_of(without) for e in scans])
    return _spread_of_rest(error**2 - explained**2, volume)


def _fit_stereo_std(c: Columns, shipped: VolumeModel) -> float:
    """The same of depth from pictures, whose deviation holds the shipped number already."""
    error = c["volume"] - c["true_volume"]
    explained = c["volume_std"]**2 - (shipped.stereo_std * c["volume"])**2
    return _spread_of_rest(error**2 - explained, c["volume"])


def _fit_lost_rim_width(c: Columns) -> Sequence[float]:
    """Median of the width lost, without noise and per metre of noise, and its relative spread."""
    at_zero, per_noise = _quantile_line(c["depth_noise_m"], c["lost_rim_width"], 0.5)
    expected = at_zero + per_noise * c["depth_noise_m"]
    return at_zero, per_noise, _spread(c["lost_rim_width"] / np.maximum(expected, 1e-9) - 1)


def _spread(errors: np.ndarray) -> float:
    """Size within which 68% of the errors lie."""
    return float(np.quantile(np.abs(errors), SETTINGS.sigma_share))


def _spread_of_rest(squares: np.ndarray, volume: np.ndarray) -> float:
    """Spread relative to V of errors of which squares (m6) are left, some of them below 0."""
    errors = np.sign(squares) * np.sqrt(np.abs(squares)) / volume
    return float(np.quantile(errors, SETTINGS.sigma_share))


def _quantile_line(x: np.ndarray, y: np.ndarray, share: float) -> tuple[float, float]:
    """Line a + b x below which a share of the points lies.

    Source: Koenker and Bassett, "Regression Quantiles" (1978), as a linear programme.
    """
    n, scale = len(x), 1000.0  # in millimetres: the solver's tolerance is absolute
    cost = np.concatenate([[0, 0], np.full(n, share), np.full(n, 1 - share)])
    line = np.hstack([np.ones((n, 1)), scale * x[:, None], np.eye(n), -np.eye(n)])
    bounds = [(None, None)] * 2 + [(0, None)] * (2 * n)
    a, b = optimize.linprog(cost, A_eq=line, b_eq=scale * y, bounds=bounds).x[:2]
    return float(a / scale), float(b)
