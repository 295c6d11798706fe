# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter play`: a recording, into whatever nodes run."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from stack_counter.cli.common import positive_number, require_bag
from stack_counter.tasks.progress import progress_bar


def add_play(commands: argparse._SubParsersAction) -> None:
    """Adds `play` to the commands of the command line."""
    play = commands.add_parser(
        "play", help="play a recorded bag into the nodes that run",
        description="Publishes the topics of a bag, with their stamps as recorded, on the ROS "
                    "domain of this shell (ROS_DOMAIN_ID). Ctrl-C ends it.")
    play.add_argument("bag", type=Path, help="rosbag2 folder, or a file: .mcap, .db3 or .bag")
    play.add_argument("--rate", type=positive_number, default=1.0, metavar="X",
                      help="speed of the recording's clock (default: 1)")
    play.add_argument("--loop", action="store_true",
                      help="again from the beginning, with stamps that go on, until Ctrl-C")
    play.set_defaults(run=_play)


def _play(options: argparse.Namespace) -> int:
    path = require_bag(options.bag)
    from stack_counter.ros.bag_player import play_bag

    with progress_bar("playing", "messages") as advance:
        play_bag(path, options.rate, options.loop, partial(print, flush=True), advance)
    return 0
