# SPDX-License-Identifier: Apache-2.0
"""Requests that nobody expects: whoever sends one must not end the node, nor forge its log."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable
from typing import Any, TypeAlias

import rclpy
from rclpy.impl.rcutils_logger import RcutilsLogger

from stack_counter.errors import ConfigError

ServiceCallback: TypeAlias = "Callable[[Any, Any], Any]"
_MOST_LETTERS = 200  # of a name that a request gives; chosen


def check_names(**names: str) -> None:
    """Checks the names that a request gives, by what they are of: logs and results repeat them.

    Raises:
        ConfigError: one is long, or would not stay on one line.
    """
    for what, name in names.items():
        if len(name) > _MOST_LETTERS or not name.isprintable():
            raise ConfigError(f"{what} {name[:40]!r} has {len(name)} letters; expected at most "
                              f"{_MOST_LETTERS} that can be printed on one line")


def guarded(kind: Any, callback: ServiceCallback, logger: RcutilsLogger) -> ServiceCallback:
    """Returns a service's callback of which an exception is logged, and the answer empty.

    rclpy hands an exception of a service's callback to whoever spins, which ends the node.

    Args:
        kind: type of the service.
        callback: takes request and response and returns the response, or is a coroutine that does.
        logger: of the node.
    """
    async def answer(request: Any, response: Any) -> Any:
        try:
            answered = callback(request, response)
            return await answered if inspect.isawaitable(answered) else answered
        except Exception:
            if not rclpy.ok():  # a signal has ended it: nothing can be published
                return response
            logger.error(f"request of {kind.__name__} dropped:\n{traceback.format_exc()}",
                         throttle_duration_sec=5.0)
            return kind.Response()

    return answer
