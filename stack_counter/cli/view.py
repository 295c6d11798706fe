# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter view`: everything live in the Foxglove app."""

from __future__ import annotations

import argparse
import ipaddress
import os
import socket
import sys

from stack_counter.cli.common import add_config_argument
from stack_counter.config import load_config
from stack_counter.errors import ConfigError
from stack_counter.files import config_path

_LOCAL, _PORT = "127.0.0.1", 8765


def add_view(commands: argparse._SubParsersAction) -> None:
    """Adds `view` to the commands of the command line."""
    view = commands.add_parser("view", help="serve all topics to the Foxglove app, live")
    add_config_argument(view)
    view.add_argument("--host", default=_LOCAL, metavar="ADDRESS",
                      help=f"address to listen on (default {_LOCAL}: this machine only)")
    view.add_argument("--port", type=_port_number, default=_PORT, help=f"default {_PORT}")
    view.set_defaults(run=_view)


def _view(options: argparse.Namespace) -> int:
    config = load_config(options.config or config_path("stack_counter.yaml")).collector
    try:
        from stack_counter.ros.viewer import camera_topics, view
    except ModuleNotFoundError as error:
        if error.name != "foxglove":
            raise
        raise ConfigError("view takes the package foxglove-sdk, which is not installed; "
                          "expected pip install 'stack_counter[view]'") from error
    return view(camera_topics(config), options.host, options.port, _print_address)


def _print_address(host: str, port: int) -> None:
    """Says where the server listens, how to look at it, and who else can."""
    try:
        address = ipaddress.ip_address(host)
        local, everywhere = address.is_loopback, address.is_unspecified
    except ValueError:  # a name
        local, everywhere = host == "localhost", False
    url = f"ws://{socket.gethostname() if everywhere else host}:{port}"
    print(f"listening on {url}, ROS domain {os.environ.get('ROS_DOMAIN_ID', 0)}; Ctrl-C ends it\n"
          f"Foxglove (desktop, or https://app.foxglove.dev for this machine): Open connection > "
          f"Foxglove WebSocket > {url}\n"
          f"layout: Layouts > Import from file > {config_path('foxglove.json')}", flush=True)
    if not local:
        print("stack-counter: WARNING: whoever reaches this address sees cameras and counts; "
              "there is no password and no encryption", file=sys.stderr, flush=True)


def _port_number(text: str) -> int:
    """Argument type: a TCP port; 0 is one that is free."""
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"'{text}'; expected 0 to 65535")
    return int(text)
