# SPDX-License-Identifier: Apache-2.0
"""The arguments of `stack-counter part`, apart from the work.

Asking for help loads none of the libraries that the work takes.
"""

from __future__ import annotations

import argparse
import os
from functools import partial
from pathlib import Path

from stack_counter.cli.common import add_config_argument, add_time_arguments, positive_number

_UNITS = ("mm", "m", "in")  # keys of parts.solid_mesh.UNITS, without its imports


def add_part(commands: argparse._SubParsersAction) -> None:
    """Adds `part` to the commands of the command line."""
    part = commands.add_parser("part", help="teach what is known of a part: its CAD file, a "
                                            "template, a counted bin")
    more = part.add_subparsers(required=True, metavar="add | template | calibrate | list | remove")
    _add_add(more)
    _add_template(more)
    _add_calibrate(more)
    listing = _command(more, "list", "the parts that are known")
    listing.set_defaults(run=partial(_run, "list_parts"))
    remove = _command(more, "remove", "forget a part")
    remove.add_argument("name", metavar="NAME")
    remove.set_defaults(run=partial(_run, "forget"))


def _command(more: argparse._SubParsersAction, name: str, text: str) -> argparse.ArgumentParser:
    command = more.add_parser(name, help=text)
    add_config_argument(command)
    command.add_argument("--catalogue", type=Path, metavar="FILE",
                         help="default: the configured one, config/parts.yaml")
    return command


def _add_add(more: argparse._SubParsersAction) -> None:
    add = _command(more, "add", "v and gamma of a part from its CAD file: simulates its piles")
    add.add_argument("name", type=_nonempty, metavar="NAME", help="what --part calls it")
    add.add_argument("--mesh", type=Path, required=True, metavar="FILE",
                     help="STL, OBJ, PLY, OFF or STEP, one watertight body")
    add.add_argument("--unit", choices=_UNITS, default="mm",
                     help="of the mesh's numbers (default mm; STEP says its own)")
    add.add_argument("--density", type=positive_number, metavar="G_CM3",
                     help="of the material, g/cm3")
    add.add_argument("--friction", type=_friction, nargs=2, metavar=("LOW", "HIGH"),
                     help="of parts on each other, if known (default 0.05 0.6)")
    add.add_argument("--piles", type=int, default=64, metavar="N",
                     help="piles to simulate (default 64); 0: none, only v and the mesh's form")
    add.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="W",
                     help="processes (default: one a core)")
    add.add_argument("--tune", action="store_true",
                     help="adapt the network's last layers to the piles, where that is better")
    add.add_argument("--force", action="store_true",
                     help="replace a part of another v, and forget its counted bins")
    add.set_defaults(run=partial(_run, "add"))


def _add_template(more: argparse._SubParsersAction) -> None:
    template = _command(more, "template", "v of a part without CAD file, from pieces on a table")
    template.add_argument("name", type=_nonempty, metavar="NAME", help="what --part calls it")
    template.add_argument("bag", type=Path, metavar="BAG",
                          help="recording of the pieces, apart from each other, nothing else "
                               "beside them; best in different rest poses")
    template.add_argument("--pieces", type=int, required=True, metavar="K", help="how many")
    add_time_arguments(template)
    template.add_argument("--force", action="store_true", help="as for add")
    template.set_defaults(run=partial(_run, "measure_template"))


def _add_calibrate(more: argparse._SubParsersAction) -> None:
    calibrate = _command(more, "calibrate", "correct a part's gamma on this rig by a counted bin")
    calibrate.add_argument("name", metavar="NAME")
    calibrate.add_argument("bag", type=Path, nargs="?", metavar="BAG", help="recording of the bin")
    add_time_arguments(calibrate)
    known = calibrate.add_mutually_exclusive_group(required=True)
    known.add_argument("--count", type=int, metavar="N", help="parts in it")
    known.add_argument("--weight", type=positive_number, metavar="KG", help="of the parts in it")
    known.add_argument("--undo", action="store_true", help="forget the last counted bin")
    calibrate.add_argument("--piece-weight", type=positive_number, default=0.0, metavar="G",
                           help="of one part; default: from its density")
    calibrate.add_argument("--force", action="store_true",
                           help="take a count that is implausible, or of another rig")
    calibrate.set_defaults(run=partial(_run, "calibrate_gamma"))


def _nonempty(text: str) -> str:
    if not text.strip() or "/" in text:
        raise argparse.ArgumentTypeError(f"'{text}'; expected a name without /")
    return text


def _friction(text: str) -> float:
    from stack_counter.parts.entry_checks import MOST_FRICTION

    value = positive_number(text)
    if value > MOST_FRICTION:
        raise argparse.ArgumentTypeError(f"'{text}'; expected {MOST_FRICTION:g} or less")
    return value


def _run(name: str, options: argparse.Namespace) -> int:
    """Runs a function of `part_commands`."""
    from stack_counter.cli import part_commands

    return getattr(part_commands, name)(options)
