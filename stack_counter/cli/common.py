# SPDX-License-Identifier: Apache-2.0
"""What several commands share: checks of arguments, settings of a command."""

from __future__ import annotations

import argparse
import math
from pathlib import Path


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


def require_bag(path: Path | None) -> Path:
    """The path of a bag that is there.

    Raises:
        FileNotFoundError: there is no such path.
    """
    if path is None or not path.exists():
        raise FileNotFoundError(f"no bag {path}; expected a rosbag2 folder or .mcap file")
    return path
