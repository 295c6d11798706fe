# SPDX-License-Identifier: Apache-2.0
"""Outcomes of counts as `recount` notes them, made by hand."""

from stack_counter.archive.outcome import Outcome

DAY_NS = 86400 * 10**9


def line(count, low=None, high=None, day=1, **changes):
    """A result's line: a count with an interval of ten parts around it, or None for an error."""
    if count is None:
        return {"schema_version": 1, "count": None, "status": "error", "exit_code": 3,
                "error": "3 views; expected more", "part": "bolt", "region": "", **changes}
    return {"schema_version": 1, "count": count, "status": "ok", "exit_code": 0, "part": "bolt",
            "count_interval": [count - 5 if low is None else low,
                               count + 5 if high is None else high],
            "region": "", "stamp": f"2026-11-{day:02d}T08:00:00.000000Z", "reasons": [],
            "seconds": {"total": 2.0}, **changes}


def outcome(name, *lines, version="1.0", **changes):
    """An outcome of one bag; its key follows from its name and version."""
    codes = [line["exit_code"] for line in lines]
    return Outcome(**{
        "bag": f"/cell/{name}", "version": version, "settings": "s",
        "counted_at": "2026-11-27T08:00:00.000000Z", "state": "same", "digest": f"digest {name}",
        "part": ("bolt", 0.0, [0.0, 0.0, 0.0]), "part_digest": "p", "key": f"{name} {version}",
        "exit_code": 0 if 0 in codes else codes[0], "results": tuple(lines), **changes})
