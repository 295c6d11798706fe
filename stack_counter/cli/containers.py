# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter container`: teach an empty one or its CAD file, list those taught."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from stack_counter.bag.time_range import TimeRange
from stack_counter.cli.common import (
    add_config_argument,
    add_time_arguments,
    chosen_time_range,
    require_bag,
)
from stack_counter.config import Config, load_config
from stack_counter.files import config_path
from stack_counter.tasks.progress import progress_bar

if TYPE_CHECKING:
    from stack_counter.container.catalogue import TaughtContainer

_UNITS = ("mm", "m", "in")  # keys of parts.solid_mesh.UNITS, without its imports
_UP_AXES = ("z", "y", "x", "-z", "-y", "-x")  # of teaching.container_mesh.UP_AXES


def add_container(commands: argparse._SubParsersAction) -> None:
    """Adds `container` to the commands of the command line."""
    container = commands.add_parser("container", help="teach an empty container, or list them")
    more = container.add_subparsers(required=True, metavar="teach | list")
    teach = more.add_parser("teach", help="measure an empty container, or read its CAD file, and "
                                          "store it")
    teach.add_argument("name", type=_nonempty, metavar="NAME",
                       help="what the setting `container` calls it")
    known = teach.add_mutually_exclusive_group(required=True)
    known.add_argument("bag", type=Path, nargs="?", metavar="BAG", help="recording of it, empty")
    known.add_argument("--mesh", type=Path, metavar="FILE",
                       help="its CAD file: STL, OBJ, PLY, OFF or STEP, one watertight body")
    teach.add_argument("--unit", choices=_UNITS, default="mm",
                       help="of the mesh's numbers (default mm; STEP says its own)")
    teach.add_argument("--up", choices=_UP_AXES, default="z", metavar="AXIS",
                       help="of the mesh, along which it is open: z (default), y or x; -z, -y or "
                            "-x as --up=-z")
    add_config_argument(teach)
    add_time_arguments(teach)
    teach.add_argument("--out", type=Path, metavar="FILE",
                       help="catalogue; default: the configured one, config/containers.yaml")
    teach.set_defaults(run=_teach)
    listing = more.add_parser("list", help="the taught containers")
    listing.add_argument("catalogue", type=Path, nargs="?", metavar="FILE",
                         help="default: config/containers.yaml")
    listing.set_defaults(run=_list_containers)


def _nonempty(text: str) -> str:
    if not text.strip() or "/" in text:
        raise argparse.ArgumentTypeError(f"'{text}'; expected a name without /")
    return text


def _teach(options: argparse.Namespace) -> int:
    # Not at the top: help is to load none of it.
    from stack_counter.container.catalogue import (
        catalogue_path,
        describe_container,
        load_containers,
        save_container,
    )

    config = load_config(options.config or config_path("stack_counter.yaml"))
    path = options.out or catalogue_path(config.reconstructor)
    if path.exists():
        load_containers(path)  # raises what is wrong with it, before the work
    taught = _teach_by_mesh(options.mesh, options.unit, options.up) if options.mesh is not None \
        else _teach_by_scan(options.bag, config, chosen_time_range(options))
    save_container(options.name, taught, path)
    print(f"{describe_container(options.name, taught)}\nstored in {path}")
    return 0


def _teach_by_scan(path: Path | None, config: Config, time_range: TimeRange) -> TaughtContainer:
    bag = require_bag(path)
    from stack_counter.teaching.teach_container import teach_container  # takes a second to load

    with progress_bar("teach", "views") as on_view:
        return teach_container(bag, config, on_view, time_range)


def _teach_by_mesh(path: Path, unit: str, up: str) -> TaughtContainer:
    from stack_counter.teaching.container_mesh import teach_from_mesh

    return teach_from_mesh(path, unit, up)


def _list_containers(options: argparse.Namespace) -> int:
    from stack_counter.container.catalogue import describe_container, load_containers

    containers = load_containers(options.catalogue)
    for name, taught in sorted(containers.items()):
        print(describe_container(name, taught))
    if not containers:
        print("no container taught yet: stack-counter container teach NAME BAG (or --mesh FILE)")
    return 0
