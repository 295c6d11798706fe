"""PASS, FAIL or UNSURE of a count message, and why in words."""

from __future__ import annotations

from stack_counter_msgs.msg import StackCount

from stack_counter.counting import verdict

_VERDICTS = {"none": StackCount.VERDICT_NONE, "pass": StackCount.VERDICT_PASS,
             "fail": StackCount.VERDICT_FAIL, "unsure": StackCount.VERDICT_UNSURE}


def set_verdict(count: StackCount, expected: int, tolerance: int) -> tuple[StackCount, str]:
    """The count with its verdict against what is expected (0: nothing), and one line on it."""
    name = verdict((count.count_low, count.count_high), expected, tolerance)
    count.verdict = _VERDICTS[name]
    said = (f"{count.count} parts, {count.confidence:.0%} sure between {count.count_low} and "
            f"{count.count_high}")
    if name == "none":
        return count, said
    why = {"pass": "all of it within", "fail": "none of it within", "unsure": "it straddles"}[name]
    return count, f"{name.upper()}: {said}; {why} {expected} +- {tolerance}"
