# SPDX-License-Identifier: Apache-2.0
"""A count as one line of JSON that says whose it is: for `result_log`, and flat for stations."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

from stack_counter_msgs.msg import StackCount, StackVolume
from std_msgs.msg import String

from stack_counter.display.report import as_dict
from stack_counter.display.result_schema import SCHEMA_VERSION, flat_line
from stack_counter.ros.conversions import from_stack_count, from_stack_volume, from_tally
from stack_counter.ros.verdicts import verdict_name
from stack_counter.views.decoding import stamp_ns


def result_line(count: StackCount, volume: StackVolume) -> dict[str, Any]:
    """Returns the line of a count: the keys of `replay --json`, and whose count it is."""
    seconds, nanoseconds = divmod(stamp_ns(count.header.stamp), 10**9)
    stamp = datetime.fromtimestamp(seconds, UTC).replace(microsecond=nanoseconds // 1000)
    line = {"schema_version": SCHEMA_VERSION, "scan_id": count.scan_id,
            "stamp": stamp.isoformat(timespec="microseconds").replace("+00:00", "Z"),
            "region": count.region, "part": count.part, "verdict": verdict_name(count)}
    if count.error:
        tally = from_tally(count.views)
        return {**line, "count": None, "status": "error", "error": count.error,
                "views": {"received": tally.received, "used": tally.used,
                          "skipped": tally.skipped}, "reasons": list(count.reasons)}
    result = as_dict(from_stack_count(count, from_stack_volume(volume)), [])
    for key in ("counts", "cells_filling_levels", "filling_level_cell_count", "visible_parts"):
        del result[key]  # what is long: running counts, cells of the overall level, parts
    return {**line, **result}


def to_flat_json(count: StackCount, volume: StackVolume) -> String:
    """Returns the message of a count, or of an error, on `result_json`: each field is one value.

    Args:
        count: as published.
        volume: what it was counted from; not read where the count is an error.
    """
    return String(data=json.dumps(flat_line(result_line(count, volume))))
