# SPDX-License-Identifier: Apache-2.0
"""Refuses to start where security is asked for and cannot be had; enclaves where it can."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec

from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.errors import ConfigError


def check_security() -> None:
    """Checks, before ROS starts, that it can do what `ROS_SECURITY_ENABLE` asks for.

    ROS itself starts without any security where the strategy is `Permissive`, its default, and
    there is no keystore; the Fast DDS of the Python wheels is built without security.

    Raises:
        ConfigError: nothing would be signed or encrypted.
    """
    if not _is_asked_for():
        return
    if find_spec("ros_wheels_bootstrapper"):
        raise ConfigError("ROS_SECURITY_ENABLE is true, but the Fast DDS of ROS 2's Python wheels "
                          "is built without security; expected a sourced ROS 2 Jazzy "
                          "(docs/security.md), or ROS_SECURITY_ENABLE not set")
    if not os.environ.get("ROS_SECURITY_KEYSTORE"):
        raise ConfigError("ROS_SECURITY_ENABLE is true, but ROS_SECURITY_KEYSTORE names no "
                          "keystore; expected its folder, or ROS_SECURITY_ENABLE not set")


def enclave_arguments(node: str) -> list[str]:
    """ROS arguments that put a node into its enclave of the shipped policy; none without security.

    Args:
        node: name of the node; an enclave that is given behind these arguments takes the place.
    """
    return ["--enclave", f"{NAMESPACE}/{node}"] if _is_asked_for() else []


def exit_if_insecure() -> None:
    """Ends the process with the line of `check_security`."""
    try:
        check_security()
    except ConfigError as error:
        sys.exit(str(error))


def _is_asked_for() -> bool:
    return os.environ.get("ROS_SECURITY_ENABLE") == "true"
