# SPDX-License-Identifier: Apache-2.0
"""What several commands share: checks of arguments, settings of a command."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from stack_counter.bag.time_range import TimeRange


def positive_integer(text: str) -> int:
    """Argument type: a whole number above 0."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"'{text}'; expected a whole number above 0")
    return int(text)


def positive_number(text: str) -> float:
    """Argument type: a finite number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"'{text}'; expected a number above 0")
    return value


def add_config_argument(command: argparse.ArgumentParser) -> None:
    """Adds `--config FILE` to a command."""
    command.add_argument("--config", type=Path, metavar="FILE", help="settings (ROS parameters)")


def add_time_arguments(command: argparse.ArgumentParser) -> None:
    """Adds `--start S` and `--end S`, between which the images of a bag are used."""
    command.add_argument("--start", type=float, metavar="S",
                         help="use images from S seconds after the bag's first message on")
    command.add_argument("--end", type=float, metavar="S",
                         help="use images before S seconds after the bag's first message")


def chosen_time_range(options: argparse.Namespace) -> TimeRange:
    """The part of the bag that `--start` and `--end` name.

    Raises:
        ConfigError: there is no such part.
    """
    return TimeRange.of_seconds(options.start, options.end)


def require_bag(path: Path | None) -> Path:
    """The path of a bag that is there.

    Raises:
        FileNotFoundError: there is no such path.
    """
    if path is None or not path.exists():
        raise FileNotFoundError(f"no bag {path}; expected a rosbag2 folder or an .mcap, .db3 "
                                "or .bag file")
    return path
