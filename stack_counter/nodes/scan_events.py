# SPDX-License-Identifier: Apache-2.0
"""What a scan session asks its node to do, in order."""

from __future__ import annotations

from dataclasses import dataclass

from stack_counter.nodes.scan_queue import QueuedScan
from stack_counter.types import View


@dataclass(frozen=True, eq=False)
class ScanOpened:
    """A scan begins: what is heard from now on belongs to it."""

    scan: QueuedScan


@dataclass(frozen=True, eq=False)
class ScanClosed:
    """All views of a scan are decided: what is heard from now on is not of it."""

    scan: QueuedScan


@dataclass(frozen=True, eq=False)
class ViewReady:
    """The reconstructor has room for this view: publish it."""

    scan: QueuedScan
    camera: str
    view: View


@dataclass(frozen=True, eq=False)
class ViewDropped:
    """A view is given up, since too many of its camera wait."""

    view: View


@dataclass(frozen=True, eq=False)
class ScanSent:
    """All views of a closed scan are sent: announce its end to the reconstructor."""

    scan: QueuedScan


@dataclass(frozen=True)
class ViewsDecided:
    """Images were accepted or skipped: publish the progress.

    Attributes:
        scan: the scan that is open; None between scans, and of a cycle that has no id yet. The id
            of a closed scan would say that another one of the same name has begun.
    """

    scan: QueuedScan | None


@dataclass(frozen=True)
class Problem:
    """Something that an operator should read.

    Attributes:
        text: one line.
        repeated: the same happens again and again; it is logged at most every few seconds.
    """

    text: str
    repeated: bool = False


ScanEvent = (ScanOpened | ScanClosed | ViewReady | ViewDropped | ScanSent | ViewsDecided
             | Problem)
