# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter run`: the three nodes, with settings of a file and of the line."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import yaml

from stack_counter.cli.common import add_config_argument
from stack_counter.config import Config, load_config, read_parameters
from stack_counter.config.parameter_files import NAMESPACE, OF_EVERY_NODE, write_parameter_file
from stack_counter.errors import ConfigError
from stack_counter.files import config_path

_NODES = ("collector", "reconstructor", "counter")


def add_run(commands: argparse._SubParsersAction) -> None:
    """Adds `run` to the commands of the command line."""
    run = commands.add_parser("run", help="start the three ROS 2 nodes and keep them running")
    add_config_argument(run)
    run.add_argument("--part", metavar="NAME", help="part of the catalogue, as part:=NAME")
    run.add_argument("parameters", nargs="*", metavar="NAME:=VALUE",
                     help="parameters on top of the file, as for launch: mode:=cycle")
    run.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], metavar="...",
                     help="for all three nodes, as -r /camera/color/image_raw:=/cam/rgb")
    run.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    file = options.config or config_path("stack_counter.yaml")
    part = [f"part:={options.part}"] if options.part else []
    given = parse_parameters([*options.parameters, *part])
    with tempfile.TemporaryDirectory(prefix="stack_counter_") as folder:
        # The nodes get a file of their full names, whatever the file calls them.
        anywhere = any("__ns:=" in argument for argument in options.ros_args)
        path = Path(folder) / "parameters.yaml"
        # Refuse at once what the nodes cannot start with.
        _check_catalogues(write_parameters(file, given, path, "/**" if anywhere else NAMESPACE))
        from stack_counter.ros.supervisor import supervise

        return supervise(path, options.ros_args)


def parse_parameters(lines: list[str]) -> dict[str, Any]:
    """The values of `NAME:=VALUE`, by name.

    Raises:
        ConfigError: not of that form, or no node has such a parameter.
    """
    given: dict[str, Any] = {}
    for line in lines:
        name, separator, text = line.partition(":=")
        if not separator:
            raise ConfigError(f"'{line}' is no parameter; expected NAME:=VALUE, as mode:=cycle")
        if not _nodes_with(name):
            raise ConfigError(f"unknown parameter '{name}' in '{line}'; expected one of "
                              "config/stack_counter.yaml")
        given[name] = _read_value(name, text)
    return given


def write_parameters(file: Path, given: dict[str, Any], out: Path, namespace: str = NAMESPACE
                     ) -> Config:
    """Writes a ROS parameter file: that of `file`, with what is given for each node that has it.

    Returns:
        The settings in the written file.

    Raises:
        ConfigError: a value that its node does not take.
    """
    settings = read_parameters(file)
    for name, value in given.items():
        for node in _nodes_with(name):
            settings.setdefault(node, {})[name] = value
    out.write_text(write_parameter_file(settings, namespace))
    return load_config(out)


def _check_catalogues(config: Config) -> None:
    """Looks up part and container: nodes that do not know them would start, and never be ready.

    Raises:
        PartError: the part is unknown.
        ConfigError: the container is unknown, or a catalogue is missing or malformed.
    """
    # Not at the top: help is to load none of it.
    from stack_counter.parts.part_lookup import configured_part, resolve_part

    for settings in (config.counter, config.collector):
        if configured_part(settings).names_a_part:
            resolve_part(configured_part(settings), settings.part_catalogue)
    if config.reconstructor.container:
        from stack_counter.container.catalogue import configured_container

        configured_container(config.reconstructor)


def _nodes_with(name: str) -> list[str]:
    """Nodes that have a parameter of this name."""
    return [node for node in _NODES
            if name in OF_EVERY_NODE or hasattr(getattr(Config(), node), name)]


def _read_value(name: str, text: str) -> Any:
    """The value of a parameter in its type; a text that is not of it stays text, to be refused."""
    default = True if name in OF_EVERY_NODE else getattr(
        getattr(Config(), _nodes_with(name)[0]), name)
    if isinstance(default, str):
        return text
    if isinstance(default, float):
        try:
            return float(text)
        except ValueError:
            return text
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text
