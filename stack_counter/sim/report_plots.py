# SPDX-License-Identifier: Apache-2.0
"""The plots of the page about simulated scenes."""

from __future__ import annotations

import io
from collections import Counter
from typing import Any

import numpy as np
from scipy import stats

from stack_counter.sim.scenes.containers import KINDS

LARGEST_SHARE = 0.12  # limit of the share of scenes that one family may have; chosen
FULL = 0.9  # fill from which the border effect is measured; chosen

# One value for each scene, by name; NaN where a heap or an empty scene has none.
Columns = dict[str, np.ndarray]


def draw_plots(columns: Columns) -> list[tuple[str, bytes]]:
    """Titles and PNG files of all plots."""
    import matplotlib
    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    plots = []
    for title, size, draw in (
            ("Counts and gamma", (12, 4), _plot_gamma), ("Containers", (12, 4), _plot_fill),
            ("Families", (12, 4.5), _plot_families), ("Complexity C", (12, 4), _plot_complexity),
            ("Border effect", (12, 4), _plot_border)):
        figure, file = Figure(figsize=size, layout="constrained"), io.BytesIO()
        draw(figure, columns)
        figure.suptitle(title)
        figure.savefig(file, format="png", dpi=100)
        plots.append((title, file.getvalue()))
    return plots


def _plot_gamma(figure: Any, columns: Columns) -> None:
    """Histograms of count and gamma, and gamma by kind of container."""
    counts, gammas, by_kind = figure.subplots(1, 3)
    low, high = max(1, columns["count"].min()), columns["count"].max() + 1
    _histogram(counts, columns["count"], "count", np.geomspace(low, high, 40))
    counts.set_xscale("log")
    _histogram(gammas, columns["gamma"], "gamma")
    kinds = [kind for kind in KINDS if (columns["kind"] == kind).any()]
    values = [_finite(columns["gamma"][columns["kind"] == kind]) for kind in kinds]
    by_kind.boxplot(values, whis=(5, 95), tick_labels=kinds, flierprops={"markersize": 2})
    by_kind.tick_params(axis="x", rotation=30)
    by_kind.set(ylabel="gamma", title="whiskers: 5% and 95%")


def _plot_fill(figure: Any, columns: Columns) -> None:
    """Fill and proportions of the containers."""
    fills, over_width, depths, walls = figure.subplots(1, 4)
    in_container = columns["kind"] != "none"
    _histogram(fills, columns["fill"][in_container], "fill")
    _scatter(over_width, columns["width"][in_container], columns["fill"][in_container],
             xlabel="width / part size", ylabel="fill")
    _histogram(depths, columns["depth"], "depth / part size")
    _histogram(walls, columns["wall"], "wall thickness / width")


def _plot_families(figure: Any, columns: Columns) -> None:
    """Share of the scenes that each family has."""
    axes = figure.subplots()
    by_share = Counter(columns["family"].tolist()).most_common()
    names, scenes = [name for name, _ in by_share], np.array([count for _, count in by_share])
    axes.bar(names, scenes / scenes.sum())
    axes.axhline(LARGEST_SHARE, color="tab:red")
    axes.tick_params(axis="x", rotation=90)
    axes.set(ylabel="share of scenes", title=f"largest: {names[0]}, "
             f"{scenes[0] / scenes.sum():.1%}; line: {LARGEST_SHARE:.0%}")


def _plot_complexity(figure: Any, columns: Columns) -> None:
    """Complexity of the distinct parts, and gamma over it."""
    parts, gammas = figure.subplots(1, 2)
    identity = np.rec.fromarrays([columns["family"], columns["seed"]])
    first = np.unique(identity, return_index=True)[1]
    _histogram(parts, columns["complexity"][first], "complexity C of the distinct parts")
    _scatter(gammas, columns["complexity"], columns["gamma"], xlabel="complexity C",
             ylabel="gamma")


def _plot_border(figure: Any, columns: Columns) -> None:
    """The paper's ratios with and without borders, as in its supplement, "Border Effects".

    Heaps have no borders.
    """
    histograms, comparison = figure.subplots(1, 2)
    full = (columns["kind"] != "none") & (columns["fill"] >= FULL)
    whole, center = columns["gamma_whole"][full], columns["gamma_center"][full]
    if not len(whole):
        histograms.set(title=f"no container is filled to {FULL:.0%}")
        return
    for values, name in ((whole, "with borders"), (center, "in the centre")):
        histograms.hist(values, np.linspace(0, max(1, whole.max(), center.max()), 41), alpha=0.6,
                        label=f"{name}: mean {values.mean():.3f}")
    histograms.legend()
    change = whole.mean() / center.mean() - 1
    histograms.set(xlabel="occupancy ratio", ylabel="scenes",
                   title=f"{len(whole)} containers, fill >= {FULL}: borders change it by "
                   f"{change:+.1%}")
    _scatter(comparison, whole, center, xlabel="gamma_whole", ylabel="gamma_center")
    comparison.axline((0, 0), slope=1, color="tab:red")


def _histogram(axes: Any, values: np.ndarray, label: str, bins: int | np.ndarray = 40) -> None:
    """Histogram of the finite values, and in the title their number."""
    finite = _finite(values)
    axes.hist(finite, bins)
    axes.set(xlabel=label, ylabel="number", title=f"n = {len(finite)}")


def _scatter(axes: Any, x: np.ndarray, y: np.ndarray, **labels: str) -> None:
    """Points, and in the title their correlation."""
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[finite], y[finite]
    axes.scatter(x, y, s=4, alpha=0.5)
    varied = len(x) > 2 and np.ptp(x) > 0 and np.ptp(y) > 0
    title = f"Spearman {stats.spearmanr(x, y)[0]:+.2f}, Pearson {stats.pearsonr(x, y)[0]:+.2f}" \
        if varied else "too few scenes for a correlation"
    axes.set(title=title, **labels)


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]
