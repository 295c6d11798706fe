# SPDX-License-Identifier: Apache-2.0
"""What the nodes have measured and counted, whichever of a volume and its count comes first."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

from stack_counter_msgs.msg import StackCount, StackVolume

from stack_counter.views.decoding import stamp_ns

# Scan, region, whether it is final, and stamp, ns: what a count shares with its volume alone.
_Key: TypeAlias = "tuple[str, str, bool, int]"


class HeardCounts:
    """Brings each volume together with its count, and keeps the counts.

    Attributes:
        counts: of each region, by its name, all counts in the order in which they came.
        last: of each region the last final count with a number, and its volume.
    """

    def __init__(self, regions: Iterable[str]):
        """Begins with nothing; `regions`: their names, one empty name where none is named."""
        self.counts: dict[str, list[StackCount]] = {region: [] for region in regions}
        self.last: dict[str, tuple[StackCount, StackVolume]] = {}
        self._volumes: dict[_Key, StackVolume] = {}  # whose counts have not come
        self._early: dict[_Key, StackCount] = {}  # counts whose volumes have not come
        self._ended: set[tuple[str, str]] = set()  # scan and region of which both came

    @property
    def is_settled(self) -> bool:
        """Whether there is a count of every volume."""
        return not self._volumes

    def has_ended(self, scan_id: str) -> bool:
        """Returns whether the final volume and count of every region of a scan have come."""
        return {(scan_id, region) for region in self.counts} <= self._ended

    def add_volume(self, volume: StackVolume) -> None:
        """Takes a volume."""
        count = self._early.pop(_key(volume), None)
        if count is None:
            self._volumes[_key(volume)] = volume
        else:
            self._join(count, volume)

    def add_count(self, count: StackCount) -> None:
        """Takes a count, or the error that there is instead."""
        self.counts[count.region].append(count)
        volume = self._volumes.pop(_key(count), None)
        if volume is None:
            self._early[_key(count)] = count
        else:
            self._join(count, volume)

    def _join(self, count: StackCount, volume: StackVolume) -> None:
        if count.final:
            self._ended.add((count.scan_id, count.region))
            if not count.error:
                self.last[count.region] = count, volume


def _key(message: StackCount | StackVolume) -> _Key:
    return message.scan_id, message.region, message.final, stamp_ns(message.header.stamp)
