# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files: which parameters such a file gives which of the three nodes.

Nodes may be named in every way that ROS 2 takes: `/stack_counter/collector`, nested
(`/stack_counter: collector: ros__parameters: ...`), by wildcards (`/**`, `/*/collector`); and by
their bare names. What comes later in a file stands on top of what comes before.

Source: rcl_yaml_param_parser, `parse.cpp`; https://design.ros2.org/articles/152_ros2_parameters.
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from stack_counter.errors import ConfigError

NAMESPACE = "/stack_counter"
# Parameters that every node has beside its settings.
OF_EVERY_NODE = ("use_sim_time", "autostart")
# Those that ROS 2 itself gives nodes, that `ros2 param dump` writes, or that cells give all nodes.
_OF_ROS = (*OF_EVERY_NODE, "qos_overrides", "start_type_description_service",
           "robot_description")
_PARAMETERS = "ros__parameters"


class _RosLoader(yaml.SafeLoader):
    """Reads numbers as ROS 2 does: 1e-3 is one, also without a point.

    A key that stands in a mapping twice is refused: YAML's reader would drop the first without a
    word, and ROS 2 takes both.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """The mapping of a node. Raises YAMLError: a key stands there twice."""
        keys = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        if twice := [key for key, number in keys.items() if number > 1]:
            raise yaml.YAMLError(f"'{twice[0]}' stands twice in one mapping; expected it once")
        return super().construct_mapping(node, deep)


_RosLoader.add_implicit_resolver("tag:yaml.org,2002:float",
                                 re.compile(r"[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+$"),
                                 list("-+0123456789"))


def read_parameter_file(path: Path, settings: Mapping[str, Collection[str]]
                        ) -> dict[str, dict[str, Any]]:
    """Reads a parameter file.

    Args:
        path: of the file.
        settings: names of the settings of each node, by the node's name.

    Returns:
        Parameters by node, nested where their names have dots; those that ROS itself gives every
        node are among them.

    Raises:
        ConfigError: not YAML, no node of ours, or a parameter that no node has.
        FileNotFoundError: no such file.
    """
    given: dict[str, dict[str, Any]] = {node: {} for node in settings}
    named, matched = [], False
    for name, values in _entries(_read_yaml(path), path):
        nodes = [node for node in settings if _matches(name, node)]
        if not nodes:
            _check_foreign(name, settings, path)
        named.append(name)
        matched |= bool(nodes)
        for key, value in values.items():
            takers = [node for node in nodes if key.split(".")[0] in (*settings[node], *_OF_ROS)]
            if nodes and not takers:
                _refuse(key, nodes, settings, path, only_near="*" in name)
            for node in takers:
                _put(given[node], key, value)
    if named and not matched:
        raise ConfigError(f"{path} names node '{named[0]}'; expected {_expected(settings)}")
    return {node: values for node, values in given.items() if values}


def without_ros_parameters(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of a node that are settings of its own."""
    return {name: value for name, value in parameters.items() if name not in _OF_ROS}


def misspelled_names(parameters: Collection[str], settings: Mapping[str, Collection[str]],
                     node: str) -> dict[str, str]:
    """Parameters of a node that are none of any node's, and the setting that was meant by each."""
    known = {name for names in settings.values() for name in names}.union(_OF_ROS)
    first = {name: name.split(".")[0] for name in parameters}
    near = {name: nearest_name(key, settings.get(node, ())) for name, key in first.items()
            if key not in known}
    return {name: meant for name, meant in near.items() if meant}


def nearest_name(name: str, known: Collection[str]) -> str:
    """The known name that is spelled most like another one; empty where none is like it."""
    return next(iter(difflib.get_close_matches(name, known, 1, 0.75)), "")


def write_parameter_file(parameters: Mapping[str, Mapping[str, Any]],
                         namespace: str = NAMESPACE) -> str:
    """The text of a parameter file that ROS 2 reads, of parameters by node."""
    return yaml.safe_dump({f"{namespace}/{node}": {_PARAMETERS: dict(values)}
                           for node, values in parameters.items()}, sort_keys=False)


def _read_yaml(path: Path) -> dict:
    if not Path(path).exists() or Path(path).is_dir():
        raise FileNotFoundError(f"no settings file '{path}'; expected a YAML file of ROS "
                                "parameters such as config/stack_counter.yaml")
    try:
        document = yaml.load(Path(path).read_text(), _RosLoader) or {}  # a safe loader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(document, dict):
        raise ConfigError(f"{path} holds {type(document).__name__}; expected node names with "
                          f"{_PARAMETERS}")
    return document


def _entries(document: Mapping, path: Path, parent: str = "") -> Iterator[tuple[str, dict]]:
    """Yields the nodes' names, joined with those of the namespaces around them, and parameters."""
    for key, body in document.items():
        name = f"{parent}/{str(key).strip('/')}" if parent else str(key)
        if not isinstance(body, dict) or not all(isinstance(k, str) for k in body):
            raise ConfigError(f"{path}: '{name}' lacks {_PARAMETERS}")
        if _PARAMETERS not in body and not any(isinstance(inner, dict) for inner in body.values()):
            raise ConfigError(f"{path}: '{name}' lacks {_PARAMETERS}")
        if _PARAMETERS in body:
            if not isinstance(body[_PARAMETERS], dict):
                raise ConfigError(f"{path}: '{name}' has {_PARAMETERS} {body[_PARAMETERS]!r}; "
                                  "expected names and values")
            yield name, {str(k): value for k, value in body[_PARAMETERS].items()}
        yield from _entries({k: inner for k, inner in body.items() if k != _PARAMETERS}, path,
                            name)


def _matches(name: str, node: str) -> bool:
    """Whether a name of a parameter file is that of one of our nodes."""
    if name.strip("/") == node:  # without a namespace
        return True
    pattern = "".join({"**": r"(/[^/]+)*", "*": r"/[^/]+"}.get(token, f"/{re.escape(token)}")
                      for token in name.strip("/").split("/"))
    return re.fullmatch(pattern, f"{NAMESPACE}/{node}") is not None


def _check_foreign(name: str, settings: Collection[str], path: Path) -> None:
    """Refuses what is meant to be one of our nodes, by its namespace or its name."""
    namespace, _, last = name.rstrip("/").rpartition("/")
    if namespace.strip("/") == NAMESPACE.strip("/") or nearest_name(last, settings):
        raise ConfigError(f"{path} names node '{name}'; expected {_expected(settings)}")


def _expected(nodes: Collection[str]) -> str:
    *names, last = (f"{NAMESPACE}/{node}" for node in nodes)
    return f"{', '.join(names)} or {last}"


def _refuse(key: str, nodes: list[str], settings: Mapping[str, Collection[str]], path: Path,
            only_near: bool) -> None:
    """Refuses a parameter that none of the nodes has.

    Args:
        key: its name.
        nodes: those that it is meant for.
        settings: of each node.
        path: of the file.
        only_near: it may be meant for other nodes, unless it is spelled nearly like one of ours.
    """
    known = sorted({name for node in nodes for name in settings[node]})
    near = nearest_name(key, known)
    if near or not only_near:
        others = [node for node in settings if key in settings[node]]
        expected = (f"'{near}'" if near else f"it under {NAMESPACE}/{others[0]}" if others
                    else f"one of {known}")
        raise ConfigError(f"{path}: unknown setting '{key}' of {', '.join(nodes)}; expected "
                          f"{expected}")


def _put(parameters: dict[str, Any], key: str, value: Any) -> None:
    """Adds a parameter, whose name may have dots, to nested ones; mappings are joined."""
    first, _, rest = key.partition(".")
    if rest:
        value = {rest: value}
    if isinstance(value, dict):
        inner = parameters.get(first)
        parameters[first] = inner = dict(inner) if isinstance(inner, dict) else {}
        for name, item in value.items():
            if first == "qos_overrides":  # topics' names, which may have dots, are no levels
                inner[name] = item
            else:
                _put(inner, str(name), item)
    else:
        parameters[key] = value
