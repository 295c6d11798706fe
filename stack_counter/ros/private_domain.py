# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that nobody else on this machine uses, for the nodes of one replay."""

from __future__ import annotations

import fcntl
import os
import random
import socket
import tempfile
from pathlib import Path
from types import TracebackType
from typing import IO

from stack_counter.errors import StackCounterError
from stack_counter.ros.processes import shared_memory_environment

# Those whose ports lie below the ports that Linux hands out itself, which ends at 100; 0 is
# everybody's, and the last four are left to who sets a domain by hand, as this package's tests do.
_DOMAINS = range(1, 97)


class DomainError(StackCounterError):
    """No ROS domain is free."""


class PrivateDomain:
    """A ROS domain that is this object's until it is closed.

    Attributes:
        number: of the domain.
        environment: environment variables with which processes are in it.
    """

    def __init__(self) -> None:
        """Draws one of the free domains.

        Raises:
            DomainError: none is free.
        """
        for self.number in random.SystemRandom().sample(_DOMAINS, len(_DOMAINS)):
            self._lock = _lock_domain(self.number)
            if self._lock is not None and not _has_participants(self.number):
                break
            self.close()
        else:
            raise DomainError(f"all ROS domains from {_DOMAINS[0]} to {_DOMAINS[-1]} are in use "
                              "on this machine; expected a free one: end other replays")
        self.environment = {"ROS_DOMAIN_ID": str(self.number),
                            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
                            **shared_memory_environment()}

    def close(self) -> None:
        """Gives the domain back; nothing of it may run any more."""
        if self._lock is not None:
            self._lock.close()

    def __enter__(self) -> PrivateDomain:
        """Returns itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Gives the domain back."""
        self.close()


def _lock_domain(number: int) -> IO[str] | None:
    """Returns an open file that is locked while the domain is taken; None where it is already."""
    path = Path(tempfile.gettempdir()) / f"stack_counter_domain_{os.getuid()}_{number}.lock"
    lock = open(path, "w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.close()
        return None
    return lock


def _has_participants(number: int) -> bool:
    """Returns whether a process of this machine, of whoever it is, is in the domain.

    The first one has a port of its own by the domain's number.

    Source: DDSI-RTPS 2.3, 9.6.1.1: port base 7400, domain gain 250, offset of unicast 10.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * number + 10))
        except OSError:
            return True
    return False
