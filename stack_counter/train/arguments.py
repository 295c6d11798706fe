# SPDX-License-Identifier: Apache-2.0
"""The arguments of `stack-counter train`, apart from the work.

Asking for help loads none of the libraries that the work takes.
"""

from __future__ import annotations

import argparse
from pathlib import Path


def add_train_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of `stack-counter train` to a command line."""
    add_arguments(parser)
    parser.add_argument("--leave-out-source", nargs="+", default=[], metavar="SOURCE",
                        help="collections of real solids, e.g. KiCad, that no member sees; each"
                        " finished member is tested on them")
    parser.add_argument("--start", type=Path, metavar="WEIGHTS",
                        help="each member begins as the one of this file that has not seen the"
                        " same fold of families, and goes on learning")
    parser.add_argument("--rate", type=float, default=2e-3, metavar="R",
                        help="highest learning rate (default 0.002); half of it suits --start")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments that all trainings of gamma-networks share to a command line."""
    parser.add_argument("--data", type=Path, nargs="+", required=True, metavar="DIR",
                        help="folders of simulated scenes; DIR:W draws them W times as often")
    parser.add_argument("--scans", type=Path, nargs="+", default=[], metavar="DIR",
                        help="truly fused scans of them (python -m stack_counter.train.scans)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--cache", type=Path, default=Path("out/heights"), metavar="DIR",
                        help="height maps are kept here")
    parser.add_argument("--folds", type=int, nargs="+", metavar="K",
                        help="members to train; each leaves out the families of its fold"
                        " (default: all)")
    parser.add_argument("--epochs", type=int, metavar="N",
                        help="passes over the data (default 20)")
    parser.add_argument("--scenes", type=int, metavar="N", help="only N of them, drawn at random")
    parser.add_argument("--encoder", default="own", choices=("own", "dinov2"),
                        help="dinov2: the paper's network, for comparison")
    parser.add_argument("--encoder-weights", type=Path, metavar="DIR",
                        help="your own folder of DINOv2 (config.json, safetensors)")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--workers", type=int, default=2, metavar="W",
                        help="members trained at a time, each on one core; with an accelerator"
                        " the other cores prepare their batches")
