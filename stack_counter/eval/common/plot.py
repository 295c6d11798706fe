# SPDX-License-Identifier: Apache-2.0
"""gamma's error over the parts' complexity C, as the paper draws it (section 4.4)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stack_counter.eval.common.case import Case

_GROUPS = 5


def plot_complexity(cases: list[Case], title: str, path: Path) -> None:
    """Draws gamma's error over C, a point a scene, with medians of groups of equal size."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    # A point for each scene, coloured by the kind of container
    done = sorted((c for c in cases if c.guesses), key=lambda c: c.complexity)
    figure, axis = pyplot.subplots(figsize=(7, 3.6))
    for kind in sorted({c.kind for c in done}):
        chosen = [c for c in done if c.kind == kind]
        axis.scatter([c.complexity for c in chosen], [_gamma_error(c) for c in chosen], s=14,
                     label=kind)
    # Medians of groups of equal size
    for group in np.array_split(np.arange(len(done)), _GROUPS):
        chosen = [done[i] for i in group]
        median = np.median([_gamma_error(c) for c in chosen])
        axis.plot((chosen[0].complexity, chosen[-1].complexity), [median] * 2, color="black",
                  linewidth=2)
    axis.axhline(0, color="grey", linewidth=0.5)
    axis.set_xlabel("complexity C of the part")
    axis.set_ylabel("estimated minus true gamma")
    axis.set_title(title)
    axis.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def _gamma_error(case: Case) -> float:
    return case.guesses["ours"].gamma - case.gamma
