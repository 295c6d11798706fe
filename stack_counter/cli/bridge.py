# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter bridge`: results to an MQTT broker, and in an OPC UA server."""

from __future__ import annotations

import argparse
import ipaddress
import logging
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stack_counter.errors import ConfigError

if TYPE_CHECKING:
    from stack_counter.bridges.settings import BridgeConfig
    from stack_counter.bridges.sinks import ResultSink


def add_bridge(commands: argparse._SubParsersAction) -> None:
    """Adds `bridge` to the commands of the command line."""
    bridge = commands.add_parser("bridge", help="results to MQTT and OPC UA")
    bridge.add_argument("config", type=Path,
                        help="settings, as config/mqtt.yaml and config/opcua.yaml")
    bridge.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], metavar="...",
                        help="as -r /stack_counter/result_json:=/cell2/result_json")
    bridge.set_defaults(run=_bridge)


def _bridge(options: argparse.Namespace) -> int:
    from stack_counter.bridges.settings import load_bridges

    config = load_bridges(options.config)
    logging.getLogger("stack_counter.bridges").setLevel(logging.INFO)
    _warn_of_clear_text(config)
    sinks = _make_sinks(config)
    from stack_counter.ros.bridge import run_bridge

    return run_bridge(sinks, options.ros_args)


def _make_sinks(config: BridgeConfig) -> list[ResultSink]:
    """Returns what results are brought to. Raises ConfigError: its package is not installed."""
    sinks: list[ResultSink] = []
    if config.mqtt is not None:
        sinks.append(_import("mqtt", "aiomqtt").MqttSink(config.mqtt))
    if config.opcua is not None:
        sinks.append(_import("opcua", "asyncua").OpcuaSink(config.opcua))
    return sinks


def _import(name: str, package: str) -> Any:
    """Returns the module of a bridge, whose extra has the name of it."""
    try:
        return import_module(f"stack_counter.bridges.{name}")
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        raise ConfigError(f"bridge to {name} takes the package {package}, which is not "
                          f"installed; expected pip install 'stack_counter[{name}]'") from error


def _warn_of_clear_text(config: BridgeConfig) -> None:
    """Says what can be read on the network, or by whom."""
    lines = []
    if config.mqtt and not config.mqtt.tls and not _is_local(config.mqtt.host):
        lines.append(f"mqtt to {config.mqtt.host} without tls: results"
                     + (" and password" if config.mqtt.username else "") + " travel in clear")
    if config.opcua and not config.opcua.username and not _is_local(config.opcua.host):
        lines.append(f"opcua on {config.opcua.host} without username: whoever reaches this "
                     "address sees the results")
    for line in lines:
        print(f"stack-counter: WARNING: {line}", file=sys.stderr, flush=True)


def _is_local(host: str) -> bool:
    """Whether an address is this machine's own."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name
        return host == "localhost"
