"""How well the whole pipeline counts, and what its interval is worth.

    stack-counter evaluate count --set unseen
"""

from __future__ import annotations

import argparse

import numpy as np

from stack_counter.eval.common import metrics
from stack_counter.eval.common.cases import ROWS, Case, add_arguments, groups, report

__all__ = ["add_arguments", "run", "table"]


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures."""
    return report(options, f"count, {options.views} views, interval of {options.confidence}",
                  table)


def table(cases: list[Case]) -> str:
    """Errors of each row, ours by group, and the worst families."""
    done = [c for c in cases if c.guesses]
    lines = [f"{len(cases) - len(done)} refused",
             f"{'':20}{'n':>5}{'NAE':>7}{'SRE':>7}{'MAE':>8}{'sMAPE':>7}{'bias':>8}"
             f"{'coverage':>22}{'half width':>11}{'seconds':>8}"]
    true = np.array([c.count for c in done], float)
    by_volume = true * (1 + np.array([c.volume_error for c in done]))
    lines.append(f"{'true gamma':20}{len(done):5}{metrics.nae(true, by_volume):7.3f}"
                 f"{metrics.sre(true, by_volume):7.3f}{metrics.mae(true, by_volume):8.1f}"
                 f"{metrics.smape(true, by_volume):7.1f}{np.mean(by_volume / true - 1):+8.3f}")
    lines += [_line(row, done, row) for row in ROWS]
    lines += [_line(f"ours, {name}", group, "ours") for name, group in groups(done).items()]
    families = {f: [c for c in done if c.family == f] for f in sorted({c.family for c in done})}
    error = {f: float(np.mean([c.guesses["ours"].count / c.count - 1 for c in group]))
             for f, group in families.items()}
    worst = sorted(error, key=lambda f: -abs(error[f]))[:12]
    lines.append("worst families: " + ", ".join(f"{f} {error[f]:+.0%}" for f in worst))
    return "\n".join(lines)


def _line(title: str, cases: list[Case], row: str) -> str:
    true = np.array([c.count for c in cases], float)
    of = [c.guesses[row] for c in cases]
    guess = np.array([g.count for g in of], float)
    hits = sum(g.low <= c.count <= g.high for g, c in zip(of, cases))
    low, high = metrics.wilson(hits, len(cases))
    half = np.median([(g.high - g.low) / 2 / max(g.count, 1) for g in of])
    return (f"{title:20}{len(cases):5}{metrics.nae(true, guess):7.3f}"
            f"{metrics.sre(true, guess):7.3f}{metrics.mae(true, guess):8.1f}"
            f"{metrics.smape(true, guess):7.1f}{np.mean(guess / true - 1):+8.3f}"
            f"{hits / len(cases):8.2f} ({low:.2f} to {high:.2f}){half:11.2f}"
            f"{np.median([g.seconds for g in of]):8.3f}")
