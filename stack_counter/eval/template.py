# SPDX-License-Identifier: Apache-2.0
"""How well v is known from pieces on a table, of parts that nothing was fitted to.

stack-counter evaluate template --workers 2
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import StackCounterError
from stack_counter.eval.common import metrics
from stack_counter.parts.template import scan_template
from stack_counter.parts.template_model import shipped_template_model
from stack_counter.sim import Shape, lay_out_pieces, load_shapes, record
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks


@dataclass(frozen=True)
class TemplateCheckSettings:
    """What is claimed of v; chosen, if nothing else is said.

    Attributes:
        seed: seed of the layouts and the recordings.
        large_m: part size from which v is claimed.
        claimed_error: relative error that is claimed.
        z: standard deviations of a 90% interval.
        worst: number of parts that are named.
    """

    seed: int = 0
    large_m: float = 0.03
    claimed_error: float = 0.08
    z: float = 1.645
    worst: int = 8


SETTINGS = TemplateCheckSettings()


@dataclass(frozen=True)
class TemplateCheck:
    """v of one part.

    Attributes:
        family, size_m: family and size of the part.
        alike: all its pieces look alike.
        error: relative error of v; None if the scan was refused.
        std: relative standard deviation of v.
    """

    family: str
    size_m: float
    alike: bool
    error: float | None
    std: float


def run(options: argparse.Namespace) -> int:
    """Prints the figures; returns the exit code."""
    shapes = load_shapes(options.library)
    measure = partial(measure_template, pieces=options.pieces, view_count=options.views)
    checks = list(progress(map_tasks(measure, shapes, Workers.of(options)), "templates", "parts",
                           len(shapes)))
    print(format_table(checks, f"{options.pieces} pieces and {options.views} views each"))
    return 0


def measure_template(shape: Shape, pieces: int, view_count: int) -> TemplateCheck:
    """Measures v of one part by a template scan."""
    table = lay_out_pieces(shape, pieces, SETTINGS.seed, shape.seed)
    views = record(table, view_count, SETTINGS.seed, color=False)
    try:
        template = scan_template(views, pieces, ReconstructorConfig())
    except StackCounterError as error:
        print(f"{shape.family} {shape.seed}: {error}")
        return TemplateCheck(shape.family, shape.part_size, alike=False, error=None, std=0.0)
    v, std = shipped_template_model().unit_volume(template)
    return TemplateCheck(shape.family, shape.part_size, template.alike,
                         error=v / shape.unit_volume - 1, std=std / v)


def format_table(checks: list[TemplateCheck], scans: str) -> str:
    """Errors by size and by whether all pieces look alike; `scans` names what was scanned."""
    lines = [f"{len(checks)} parts, {scans}, "
             f"{sum(c.error is None for c in checks)} refused",
             f"{'':32}{'n':>4}{'mean':>8}{'median':>8}{'bias':>8}{'within 8%':>11}{'coverage':>20}"
             f"{'std':>7}"]
    done = [c for c in checks if c.error is not None]
    large = [c for c in done if c.size_m >= SETTINGS.large_m]
    for title, group in (
            (f"{1000 * SETTINGS.large_m:.0f} mm and larger", [c for c in large if not c.alike]),
            ("the same, all pieces alike", [c for c in large if c.alike]),
            ("smaller", [c for c in done if c.size_m < SETTINGS.large_m]), ("all", done)):
        if group:
            lines.append(_format_line(title, group))
    worst = sorted(large, key=lambda c: -abs(c.error or 0.0))[:SETTINGS.worst]
    lines.append("worst: " + ", ".join(f"{c.family} {c.error:+.0%}" for c in worst))
    return "\n".join(lines)


def _format_line(title: str, checks: list[TemplateCheck]) -> str:
    error = np.array([c.error for c in checks], float)
    hits = int(sum(abs(np.log1p(e)) < SETTINGS.z * c.std for e, c in zip(error, checks)))
    low, high = metrics.wilson_interval(hits, len(checks))
    within = np.mean(np.abs(error) < SETTINGS.claimed_error)
    return (f"{title:32}{len(checks):4}{np.abs(error).mean():8.3f}"
            f"{np.median(np.abs(error)):8.3f}{error.mean():+8.3f}{within:11.2f}"
            f"{hits / len(checks):8.2f} ({low:.2f}-{high:.2f})"
            f"{np.median([c.std for c in checks]):7.3f}")
