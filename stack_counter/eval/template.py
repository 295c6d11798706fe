"""How well v is known from pieces on a table, of parts that nothing was fitted to.

    stack-counter evaluate template --workers 2
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import StackCounterError
from stack_counter.eval.common import metrics
from stack_counter.parts.template import scan_template, shipped
from stack_counter.sim import Shape, lay_out_pieces, load_shapes, record

_SEED = 0
_LARGE_M = 0.03  # part size from which v is claimed
_Z = 1.645  # standard deviations of a 90% interval
_CLAIMED = 0.08


@dataclass(frozen=True)
class Result:
    """v of one part: relative error and standard deviation; None if the scan was refused."""

    family: str
    size_m: float
    alike: bool
    error: float | None
    std: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `evaluate template`."""
    parser.add_argument("--library", type=Path, default=Path("data/unseen/shapes.npz"),
                        metavar="FILE", help="parts (default: the unseen ones)")
    parser.add_argument("--pieces", type=int, default=6, metavar="K")
    parser.add_argument("--views", type=int, default=12, metavar="N")
    parser.add_argument("--workers", type=int, default=1, metavar="W")


def run(options: argparse.Namespace) -> int:
    """Prints the figures."""
    shapes = load_shapes(options.library)
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        results = list(tqdm(pool.map(measure, shapes, [options.pieces] * len(shapes),
                                     [options.views] * len(shapes)),
                            total=len(shapes), unit=" parts"))
    print(table(results, f"{options.pieces} pieces and {options.views} views each"))
    return 0


def measure(shape: Shape, pieces: int, count: int) -> Result:
    """One template scan."""
    views = record(lay_out_pieces(shape, pieces, _SEED, shape.seed), count, _SEED, color=False)
    try:
        template = scan_template(views, pieces, ReconstructorConfig())
    except StackCounterError as error:
        print(f"{shape.family} {shape.seed}: {error}")
        return Result(shape.family, shape.part_size, False, None, 0.0)
    v, std = shipped().unit_volume(template)
    return Result(shape.family, shape.part_size, template.alike, v / shape.unit_volume - 1,
                  std / v)


def table(results: list[Result], scans: str) -> str:
    """Errors by size and by whether all pieces look alike."""
    lines = [f"{len(results)} parts, {scans}, "
             f"{sum(r.error is None for r in results)} refused",
             f"{'':32}{'n':>4}{'mean':>8}{'median':>8}{'bias':>8}{'within 8%':>11}{'coverage':>20}"
             f"{'std':>7}"]
    done = [r for r in results if r.error is not None]
    large = [r for r in done if r.size_m >= _LARGE_M]
    for title, of in ((f"{1000 * _LARGE_M:.0f} mm and larger", [r for r in large if not r.alike]),
                      ("the same, all pieces alike", [r for r in large if r.alike]),
                      ("smaller", [r for r in done if r.size_m < _LARGE_M]), ("all", done)):
        if of:
            lines.append(_line(title, of))
    worst = sorted(large, key=lambda r: -abs(r.error or 0.0))[:8]
    lines.append("worst: " + ", ".join(f"{r.family} {r.error:+.0%}" for r in worst))
    return "\n".join(lines)


def _line(title: str, of: list[Result]) -> str:
    error = np.array([r.error for r in of], float)
    hits = int(sum(abs(np.log1p(e)) < _Z * r.std for e, r in zip(error, of)))
    low, high = metrics.wilson(hits, len(of))
    return (f"{title:32}{len(of):4}{np.abs(error).mean():8.3f}{np.median(np.abs(error)):8.3f}"
            f"{error.mean():+8.3f}{np.mean(np.abs(error) < _CLAIMED):11.2f}"
            f"{hits / len(of):8.2f} ({low:.2f}-{high:.2f}){np.median([r.std for r in of]):7.3f}")
