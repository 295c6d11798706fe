# SPDX-License-Identifier: Apache-2.0
"""The arguments of `stack-counter evaluate`, apart from the work.

Asking for help loads none of the libraries that the work takes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from stack_counter.picture_baselines.kinds import KINDS
from stack_counter.tasks.workers import Workers


def _add_set_argument(parser: argparse.ArgumentParser) -> None:
    """Adds `--set`, which names the scenes of an evaluation."""
    parser.add_argument("--set", required=True, metavar="SET",
                        help="unseen, unseen-mixed or a folder of simulated scenes")


def _add_acceptance_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate acceptance`."""
    parser.add_argument("--library", type=Path, required=True, metavar="FILE",
                        help="parts, as for `simulate --library`")
    parser.add_argument("--solids", type=int, default=200, metavar="N",
                        help="drawn from it (default 200)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the draw")
    parser.add_argument("--piles", type=int, default=8, metavar="N",
                        help="of each part (default 8; 0: its convex pieces alone)")
    Workers.add_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every solid here")


def _add_case_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options that `evaluate gamma` and `evaluate count` share."""
    _add_set_argument(parser)
    parser.add_argument("--scenes", type=int, metavar="N", help="only the first N")
    parser.add_argument("--depth", choices=("ideal", "noisy", "pictures"), default="noisy",
                        help="noisy: recordings through the pipeline; pictures: the same without"
                        " depth, from colour and labels (half a minute a scene; name 24 views);"
                        " ideal: true V and surface")
    parser.add_argument("--views", type=int, default=12, metavar="N", help="of each recording")
    parser.add_argument("--confidence", type=float, default=0.9, metavar="P")
    parser.add_argument("--weights", type=Path, metavar="PATH", help="of the network")
    Workers.add_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every scene here")
    parser.add_argument("--plot", type=Path, metavar="PNG",
                        help="draw gamma's error over the parts' complexity here")


def _add_count_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate count`."""
    _add_case_arguments(parser)
    _add_baseline_arguments(parser)


def _add_real_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate real`."""
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE",
                        help="folder of 3DC-Real, or one like it")
    _add_baseline_arguments(parser)
    parser.add_argument("--exemplars", type=Path, metavar="FILE",
                        help="YAML of boxes [x0, y0, x1, y1] around some parts by scene, pixels"
                        " of its key view, for bmnet")
    parser.add_argument("--pictures", type=Path, metavar="DIR",
                        help="write each key view here, as the baseline sees it")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every scene here")


def _add_baseline_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds what names one of the paper's baselines."""
    parser.add_argument("--baseline", choices=list(KINDS),
                        help="measure this one of the paper's, which sees one colour picture of"
                        " each scene, instead of the pipeline")
    parser.add_argument("--baseline-weights", type=Path, nargs="+", default=[], metavar="PATH",
                        help="what it needs: " + "; ".join(
                            f"{name}: {', '.join(kind.needs)}" for name, kind in KINDS.items()))


def _add_benchmark_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate benchmark`."""
    _add_set_argument(parser)
    parser.add_argument("--scenes", type=int, default=10, metavar="N",
                        help="spread over the set (default 10)")
    parser.add_argument("--views", type=int, default=12, metavar="N", help="of each recording")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the recordings")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all figures here")


def _add_images_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `stack-counter evaluate images`."""
    _add_set_argument(parser)
    parser.add_argument("--scenes", type=int, default=15, metavar="N", help="the first N")
    parser.add_argument("--views", type=int, default=24, help="pictures of a recording")
    parser.add_argument("--seed", type=int, default=0, help="of the recordings")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the figures here")


def _add_labels_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate labels`."""
    _add_set_argument(parser)
    parser.add_argument("--scenes", type=int, default=30, metavar="N", help="how many of them")
    parser.add_argument("--seed", type=int, default=0, metavar="S",
                        help="of the choice of scenes, the recordings and the prompts")
    parser.add_argument("--views", type=int, default=8, help="of a recording (default 8)")
    parser.add_argument("--depth", action=argparse.BooleanOptionalAction, default=True,
                        help="views with depth; without, prompted only")
    Workers.add_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the scenes' IoU here")


def _add_live_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate live`."""
    _add_set_argument(parser)
    parser.add_argument("--scenes", type=int, default=10, metavar="N", help="the first N")
    parser.add_argument("--picks", type=int, default=20, metavar="K")
    parser.add_argument("--share", type=float, default=0.0, metavar="S",
                        help="take this share of the parts in K picks of several, not one each")
    parser.add_argument("--camera", choices=("static", "tf", "returning"),
                        default="static", help="a fixed one "
                        "with its pose in /tf_static or in /tf, or an arm's that goes back and "
                        "forth between two places (default: static)")
    Workers.add_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every stamp here")


def _add_parts_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate parts`."""
    parser.add_argument("--set", default="unseen-rigs", metavar="SET",
                        help="unseen-rigs or a folder of scenes of `simulate --plan rig`")
    parser.add_argument("--rigs", type=int, metavar="N", help="only the first N")
    parser.add_argument("--piles", type=int, default=64, metavar="N", help="of `part add`")
    parser.add_argument("--container", action="store_true",
                        help="`part add` is told the kind and inner size of each rig's container")
    parser.add_argument("--confidence", type=float, default=0.9, metavar="P")
    Workers.add_arguments(parser)
    parser.add_argument("--cache", type=Path, default=Path("out/part-piles"), metavar="DIR",
                        help="where simulated piles are kept: a run resumes"
                             " (default out/part-piles)")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every count here")


def _add_robustness_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate robustness`."""
    parser.add_argument("--set", default="train-deep", metavar="SET",
                        help="whose piles are built with, default train-deep")
    parser.add_argument("--scenes", type=int, default=240, metavar="N", help="number of scans")
    parser.add_argument("--only", type=int, metavar="NUMBER", help="this scan alone")
    parser.add_argument("--kind", metavar="KIND", help="of all scans those that are hard in this "
                                                       "way, as the table names it")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    Workers.add_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every scan here")


def _add_surface_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate surface`."""
    _add_set_argument(parser)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="scenes left out first")
    parser.add_argument("--scenes", type=int, default=3, metavar="N", help="how many of them")
    parser.add_argument("--views", type=int, default=24, metavar="N", help="of each recording")
    parser.add_argument("--width", type=int, default=1280, metavar="PX", help="of the pictures")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the recordings")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every scene here")


def _add_template_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate template`."""
    parser.add_argument("--library", type=Path, default=Path("data/unseen/shapes.npz"),
                        metavar="FILE", help="parts (default: the unseen ones)")
    parser.add_argument("--pieces", type=int, default=6, metavar="K")
    parser.add_argument("--views", type=int, default=12, metavar="N")
    Workers.add_arguments(parser)


def _add_visible_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate visible`."""
    _add_set_argument(parser)
    parser.add_argument("--scenes", type=int, metavar="N", help="only the first N")
    parser.add_argument("--depth", choices=("ideal", "noisy", "pictures"), default="noisy",
                        help="as for `evaluate count`")
    parser.add_argument("--views", type=int, default=12, metavar="N", help="of each recording")
    parser.add_argument("--weights", type=Path, metavar="PATH",
                        help="of the network that finds parts (default: the shipped one)")
    parser.add_argument("--poses", type=int, default=0, metavar="N",
                        help="of the best N parts of each scene, whose mesh is known, the pose is"
                        " found as well")
    Workers.add_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every scene here")
    parser.add_argument("--pictures", type=Path, metavar="DIR",
                        help="draw what was found in each scene here, over the surface")


def _add_volume_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate volume`."""
    _add_set_argument(parser)
    parser.add_argument("--scenes", type=int, metavar="N", help="only the first N")
    parser.add_argument("--views", type=int, default=12, metavar="N", help="of each recording")
    parser.add_argument("--missing", type=float, default=0.0, metavar="SHARE",
                        help="of the depth pixels, in patches")
    parser.add_argument("--pose-mm", type=float, default=0.5, metavar="X", help="pose noise")
    parser.add_argument("--pose-deg", type=float, default=0.05, metavar="X", help="pose noise")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the recordings")
    Workers.add_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every scene here")


def _add_weight_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `evaluate weight`."""
    _add_set_argument(parser)
    parser.add_argument("--scenes", type=int, default=50, metavar="N",
                        help="the first N (default 50)")
    parser.add_argument("--scatter", type=float, default=0.01, metavar="SHARE",
                        help="standard deviation from piece to piece (default 0.01)")
    parser.add_argument("--scale-std-g", type=float, default=5.0, metavar="G",
                        help="standard deviation of scale and tare (default 5: of a scale with "
                             "steps of 10 g)")
    Workers.add_arguments(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every weighing here")


# What adds the arguments of an evaluation, by the name of its module.
ADD_ARGUMENTS: dict[str, Callable[[argparse.ArgumentParser], None]] = {
    "acceptance": _add_acceptance_arguments,
    "gamma": _add_case_arguments,
    "count": _add_count_arguments,
    "benchmark": _add_benchmark_arguments,
    "images": _add_images_arguments,
    "labels": _add_labels_arguments,
    "live": _add_live_arguments,
    "parts": _add_parts_arguments,
    "real": _add_real_arguments,
    "robustness": _add_robustness_arguments,
    "surface": _add_surface_arguments,
    "template": _add_template_arguments,
    "visible": _add_visible_arguments,
    "volume": _add_volume_arguments,
    "weight": _add_weight_arguments,
}
