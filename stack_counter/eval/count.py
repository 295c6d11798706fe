# SPDX-License-Identifier: Apache-2.0
"""How well the whole pipeline counts, and what its interval is worth.

    stack-counter evaluate count --set unseen
    stack-counter evaluate count --set unseen --baseline vit_h --baseline-weights FILE

The second measures one of the paper's baselines, which counts from one colour picture.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from stack_counter.eval.common import metrics
from stack_counter.eval.common.case import Case, Guess
from stack_counter.eval.common.cases import group_cases, report_cases
from stack_counter.eval.common.picture_cases import check_baseline_options, report_baseline

_WORST_FAMILIES = 12


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    check_baseline_options(options)
    if options.baseline:
        return report_baseline(options)
    return report_cases(
        options, f"count, {options.views} views, interval of {options.confidence}", format_table)


def format_table(cases: list[Case]) -> str:
    """Errors of each row, ours by group, and the worst families."""
    done = [c for c in cases if c.guesses]
    lines = [f"{len(cases) - len(done)} refused",
             f"{'':20}{'n':>5}{'NAE':>7}{'SRE':>7}{'MAE':>8}{'sMAPE':>7}{'bias':>8}"
             f"{'coverage':>22}{'half width':>11}{'seconds':>8}"]
    # What V's error alone does to the count
    true = np.array([c.count for c in done], float)
    by_volume = true * (1 + np.array([c.volume_error for c in done]))
    lines.append(_format_errors("true gamma", true, by_volume))
    # Every estimator, and ours by group
    lines += [_format_line(row, done, row) for row in done[0].guesses] if done else []
    lines += [_format_line(f"ours, {name}", group, "ours")
              for name, group in group_cases(done).items()]
    # Mean relative error of the families
    families = {f: [c for c in done if c.family == f] for f in sorted({c.family for c in done})}
    error = {f: float(np.mean([c.guesses["ours"].count / c.count - 1 for c in group]))
             for f, group in families.items()}
    worst = sorted(error, key=lambda f: -abs(error[f]))[:_WORST_FAMILIES]
    lines.append(_format_flagged([c.guesses["ours"] for c in done]))
    lines.append("worst families: " + ", ".join(f"{f} {error[f]:+.0%}" for f in worst))
    return "\n".join(lines)


def _format_flagged(guesses: list[Guess]) -> str:
    """How many counts are degraded, and how often each reason was given that degrades."""
    flagged = [g for g in guesses if g.status != "ok"]
    reasons = Counter(str(r) for g in flagged for r in g.reasons if r.degrades)
    return (f"degraded: {len(flagged)} of {len(guesses)} ({len(flagged) / len(guesses):.0%})"
            + "".join(f", {reason} {n}" for reason, n in reasons.most_common()))


def _format_line(title: str, cases: list[Case], row: str) -> str:
    """Errors of one estimator, and coverage and half width of its interval."""
    true = np.array([c.count for c in cases], float)
    guesses = [c.guesses[row] for c in cases]
    hits = sum(g.low <= c.count <= g.high for g, c in zip(guesses, cases))
    low, high = metrics.wilson_interval(hits, len(cases))
    half_width = np.median([(g.high - g.low) / 2 / max(g.count, 1) for g in guesses])
    return (_format_errors(title, true, np.array([g.count for g in guesses], float))
            + f"{hits / len(cases):8.2f} ({low:.2f} to {high:.2f}){half_width:11.2f}"
            f"{np.median([g.seconds for g in guesses]):8.3f}")


def _format_errors(title: str, true: np.ndarray, guess: np.ndarray) -> str:
    return (f"{title:20}{len(true):5}{metrics.nae(true, guess):7.3f}"
            f"{metrics.sre(true, guess):7.3f}{metrics.mae(true, guess):8.1f}"
            f"{metrics.smape(true, guess):7.1f}{np.mean(guess / true - 1):+8.3f}")
