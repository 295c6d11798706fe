# SPDX-License-Identifier: Apache-2.0
"""Predicted against measured: the rows, what they sum up to, and the part of the page."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter.errors import StackCounterError
from stack_counter.sim.reality.experiments import Experiment, counted_volume
from stack_counter.sim.reality.piles import Pile

# What stands between these in a page is written anew.
BEGIN, END = "<!-- reality: begin -->", "<!-- reality: end -->"
_PLACE = re.compile(f"{BEGIN}.*?{END}", re.DOTALL)
_HEAD = ("experiment", "pour", "measured", "predicted", "difference", "", "source")


class PageError(StackCounterError):
    """The page has no place for the table."""


@dataclass(frozen=True)
class Row:
    """One experiment and its simulated piles.

    Attributes:
        experiment: what was measured.
        measured: its share of the bulk volume.
        friction: of all contacts of the piles.
        piles: what the simulated piles gave.
    """

    experiment: Experiment
    measured: float
    friction: float
    piles: list[Pile]

    @property
    def predicted(self) -> float:
        """Mean share of the simulated piles."""
        return float(np.mean([pile.share for pile in self.piles]))

    @property
    def scatter(self) -> float:
        """Standard deviation of the shares of single piles; NaN for one pile."""
        return float(np.std([pile.share for pile in self.piles], ddof=1)) \
            if len(self.piles) > 1 else float("nan")

    @property
    def difference(self) -> float:
        """Predicted less measured share."""
        return self.predicted - self.measured

    @property
    def gamma_difference(self) -> float:
        """The difference in gamma, where hulls are compared too."""
        shape = self.experiment.part()
        return self.difference * shape.unit_volume / counted_volume(self.experiment, shape)

    def cells(self) -> tuple[str, ...]:
        """Texts of the row's cells, as in the head of the table."""
        e = self.experiment
        scatter = f" ± {self.scatter:.3f}" if len(self.piles) > 1 else ""
        return (e.name + (" (hulls)" if e.of_hull else ""),
                f"{e.pour}, {self.friction:.2f}", f"{self.measured:.3f} ± {e.spread:.3f}",
                f"{self.predicted:.3f}{scatter}",
                f"{self.difference:+.3f} ({self.difference / self.measured:+.0%})",
                "fitted" if e.fitted else "predicted", e.source)


def summarize(rows: Sequence[Row]) -> list[str]:
    """Sentences on the predicted and the fitted rows; none where there are no rows."""
    lines = []
    for word, fitted in (("predicted", False), ("fitted", True)):
        chosen = [row for row in rows if row.experiment.fitted == fitted]
        if not chosen:
            continue
        errors = np.array([row.difference for row in chosen])
        worst = chosen[int(np.argmax(abs(errors)))]
        in_gamma = np.mean([abs(row.gamma_difference) for row in chosen])
        lines.append(f"{len(chosen)} {word}: mean absolute error {abs(errors).mean():.3f} (in "
                     f"gamma, hollow parts too, {in_gamma:.3f}), bias {errors.mean():+.3f}, worst "
                     f"{worst.experiment.name} ({worst.experiment.pour}) {worst.difference:+.3f}.")
    cpu_s = [pile.cpu_s for row in rows for pile in row.piles]
    tries = sum(pile.tries for row in rows for pile in row.piles)
    return [*lines, f"{len(cpu_s)} piles from {tries} tries, {np.sum(cpu_s) / 60:.1f} CPU "
                    f"minutes, {np.max(cpu_s):.0f} s the longest."]


def markdown_table(rows: Sequence[Row]) -> str:
    """The table of a page."""
    lines = [_HEAD, ("---",) * len(_HEAD), *(row.cells() for row in rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def check_page(page: Path) -> None:
    """Sees to it that a page has one place for the table.

    Raises:
        PageError: it has not both marks, once each, or cannot be read.
    """
    try:
        places = len(_PLACE.findall(page.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        raise PageError(f"{page} cannot be read: {error}") from error
    if places != 1:
        raise PageError(f"{page} has {places} places for the table; expected one between {BEGIN} "
                        f"and {END}")


def write_into_page(page: Path, text: str) -> None:
    """Puts the text between the two marks of a page, as `check_page` found them."""
    old = page.read_text(encoding="utf-8")
    page.write_text(_PLACE.sub(lambda _: f"{BEGIN}\n{text}\n{END}", old), encoding="utf-8")
