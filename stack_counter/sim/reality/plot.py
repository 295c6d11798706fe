# SPDX-License-Identifier: Apache-2.0
"""The plot of predicted against measured shares."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stack_counter.sim.reality.table import Row

GOAL = 0.06  # most that a prediction is to be off by
_COLORS = {"loose": "tab:blue", "poured": "tab:green", "dense": "tab:red"}


def draw_plot(rows: Sequence[Row], path: Path) -> None:
    """Writes a PNG: every row as measured and predicted, with both errors."""
    import matplotlib
    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 1.2 + 0.3 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for y, row in enumerate(rows):
        e, color = row.experiment, _COLORS[row.experiment.pour]
        axes.barh(y, 2 * GOAL, left=row.measured - GOAL, height=0.8, color="0.94")
        axes.errorbar(row.measured, y + 0.15, xerr=e.spread, fmt="|", color="black", markersize=9)
        axes.errorbar(row.predicted, y - 0.15, xerr=row.scatter, fmt="o", color=color,
                      markerfacecolor="white" if e.fitted else color)
    axes.set_yticks(range(len(rows)), [
        f"{row.experiment.name}, {row.experiment.pour}" for row in rows])
    axes.invert_yaxis()
    axes.grid(axis="x", color="0.85")
    axes.set(xlabel="share of the bulk volume")
    figure.suptitle(f"black: measured; filled: predicted; open: fitted; grey: measured ± {GOAL}")
    figure.savefig(path, dpi=90)
