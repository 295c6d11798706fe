# SPDX-License-Identifier: Apache-2.0
"""The verdict of a count's message against what is expected."""

from __future__ import annotations

from stack_counter_msgs.msg import StackCount

from stack_counter.counting import verdict

_VERDICT_NUMBERS = {"none": StackCount.VERDICT_NONE, "pass": StackCount.VERDICT_PASS,
                    "fail": StackCount.VERDICT_FAIL, "unsure": StackCount.VERDICT_UNSURE}
_VERDICT_PHRASES = {"pass": "all of it within", "fail": "none of it within",
                    "unsure": "it straddles"}


def verdict_name(message: StackCount) -> str:
    """Returns the verdict of a count's message, as `counting.verdict` names it."""
    return next((name for name, number in _VERDICT_NUMBERS.items() if number == message.verdict),
                "none")


def set_verdict(message: StackCount, expected: int, tolerance: int) -> str:
    """Sets the verdict of a count against what is expected; returns one line that explains it.

    Args:
        message: count whose field `verdict` is set.
        expected: number of parts that should be there; 0 for none expected.
        tolerance: number of parts by which the count may differ.
    """
    name = verdict((message.count_low, message.count_high), expected, tolerance)
    message.verdict = _VERDICT_NUMBERS[name]
    result = (f"{message.count} parts, {message.confidence:.0%} sure between "
              f"{message.count_low} and {message.count_high}")
    if name == "none":
        return result
    return f"{name.upper()}: {result}; {_VERDICT_PHRASES[name]} {expected} +- {tolerance}"
