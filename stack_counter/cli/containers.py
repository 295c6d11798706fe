# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter container`: teach an empty container, list those taught."""

from __future__ import annotations

import argparse
from pathlib import Path

from stack_counter.cli.common import add_config_argument, progress_bar, require_bag
from stack_counter.config import load_config
from stack_counter.container.catalogue import (
    catalogue_path,
    describe_container,
    load_containers,
    save_container,
)
from stack_counter.files import config_path


def add_container(commands: argparse._SubParsersAction) -> None:
    """Adds `container` to the commands of the command line."""
    container = commands.add_parser("container", help="teach an empty container, or list them")
    more = container.add_subparsers(required=True, metavar="teach | list")
    teach = more.add_parser("teach", help="measure an empty container and store it")
    teach.add_argument("name", type=_nonempty, metavar="NAME",
                       help="what the setting `container` calls it")
    teach.add_argument("bag", type=Path, metavar="BAG", help="recording of it, empty")
    add_config_argument(teach)
    teach.add_argument("--out", type=Path, metavar="FILE",
                       help="catalogue; default: the configured one, config/containers.yaml")
    teach.set_defaults(run=_teach)
    listing = more.add_parser("list", help="the taught containers")
    listing.add_argument("catalogue", type=Path, nargs="?", metavar="FILE",
                         help="default: config/containers.yaml")
    listing.set_defaults(run=_list_containers)


def _nonempty(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError(f"'{text}'; expected a name")
    return text


def _teach(options: argparse.Namespace) -> int:
    config = load_config(options.config or config_path("stack_counter.yaml"))
    bag = require_bag(options.bag)
    path = options.out or catalogue_path(config.reconstructor)
    if path.exists():
        load_containers(path)  # raises what is wrong with it, before the work
    from stack_counter.teaching.teach_container import teach_container  # takes a second to load

    with progress_bar("teach", "views") as on_view:
        taught = teach_container(bag, config, on_view)
    save_container(options.name, taught, path)
    print(f"{describe_container(options.name, taught)}\nstored in {path}")
    return 0


def _list_containers(options: argparse.Namespace) -> int:
    containers = load_containers(options.catalogue)
    for name, taught in sorted(containers.items()):
        print(describe_container(name, taught))
    if not containers:
        print("no container taught yet: stack-counter container teach NAME BAG")
    return 0
