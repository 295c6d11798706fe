# SPDX-License-Identifier: Apache-2.0
"""How well gamma is estimated, beside the paper's baselines.

stack-counter evaluate gamma --set unseen --depth noisy
"""

from __future__ import annotations

import argparse

import numpy as np

from stack_counter.eval.common import metrics
from stack_counter.eval.common.case import Case
from stack_counter.eval.common.cases import group_cases, report_cases


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    return report_cases(options, "gamma", format_table)


def format_table(cases: list[Case]) -> str:
    """Errors of each row, and ours by group."""
    done = [c for c in cases if c.guesses]
    lines = [f"{len(cases) - len(done)} refused",
             f"{'':20}{'n':>5}{'MAE':>8}{'RMSE':>8}{'sMAPE':>8}{'R2':>8}{'bias':>8}"]
    lines += [_format_line(row, done, row) for row in done[0].guesses] if done else []
    lines += [_format_line(f"ours, {name}", group, "ours")
              for name, group in group_cases(done).items()]
    return "\n".join(lines)


def _format_line(title: str, cases: list[Case], row: str) -> str:
    true = np.array([c.gamma for c in cases])
    guess = np.array([c.guesses[row].gamma for c in cases])
    return (f"{title:20}{len(cases):5}{metrics.mae(true, guess):8.3f}"
            f"{metrics.rmse(true, guess):8.3f}{metrics.smape(true, guess):8.2f}"
            f"{metrics.r2(true, guess):8.2f}{(guess - true).mean():+8.3f}")
