# SPDX-License-Identifier: Apache-2.0
"""What the nodes log of a scan, one line each. No ROS."""

from __future__ import annotations

from stack_counter.nodes.scan_queue import QueuedScan, ScanQueue
from stack_counter.types import ViewTally


def opened_line(scan: QueuedScan) -> str:
    """Says what an opened scan is of, and which cameras it lacks."""
    name, unit_volume = scan.part.name, scan.part.unit_volume
    part = f"part '{name}'" if name else \
        f"unit volume {unit_volume * 1e6:g} cm3" if unit_volume else "the counter's part"
    missing = f"; no view of {', '.join(scan.missing)}" if scan.missing else ""
    return f"scan '{scan.scan_id}' opened: {part}{missing}"


def views_line(scan_id: str, tally: ViewTally) -> str:
    """Says what has become of the views of a scan that ends."""
    skips = ", ".join(f"{number} {reason}" for reason, number in tally.skipped.items())
    return (f"scan '{scan_id}': {tally.used} views used of {tally.received}"
            + (f"; skipped: {skips}" if skips else ""))


def forgotten_line(queue: ScanQueue) -> str:
    """Says which scans are lost because the collector is reset; "" if there are none."""
    if queue.first is None:
        return ""
    others = f" and {len(queue) - 1} more" if len(queue) > 1 else ""
    return f"scan '{queue.first.scan_id}'{others} lost: reset was called"
