"""gamma's error over the parts' complexity C, as the paper draws it (section 4.4)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stack_counter.eval.common.cases import Case

_BINS = 5


def plot_complexity(cases: list[Case], title: str, path: Path) -> None:
    """Writes a picture: gamma's error over C, a point a scene, with the medians of groups of
    equal size."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    done = sorted((c for c in cases if c.guesses), key=lambda c: c.complexity)
    figure, axis = pyplot.subplots(figsize=(7, 3.6))
    for kind in sorted({c.kind for c in done}):
        of = [c for c in done if c.kind == kind]
        axis.scatter([c.complexity for c in of], [_error(c) for c in of], s=14, label=kind)
    for group in np.array_split(np.arange(len(done)), _BINS):
        of = [done[i] for i in group]
        middle, ends = np.median([_error(c) for c in of]), (of[0].complexity, of[-1].complexity)
        axis.plot(ends, [middle] * 2, color="black", linewidth=2)
    axis.axhline(0, color="grey", linewidth=0.5)
    axis.set_xlabel("complexity C of the part")
    axis.set_ylabel("gamma said minus true gamma")
    axis.set_title(title)
    axis.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def _error(case: Case) -> float:
    return case.guesses["ours"].gamma - case.gamma
