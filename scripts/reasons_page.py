# SPDX-License-Identifier: Apache-2.0
"""Writes docs/reasons.md, the page of all reasons, from the enum of them.

python scripts/reasons_page.py
"""

from pathlib import Path

from stack_counter.types import Reason

PAGE = Path(__file__).parent.parent / "docs" / "reasons.md"
HEAD = """# Reasons

`reasons` of a volume and of a count name what qualifies the result. A reason that degrades gives
the count the status `degraded`: it is less than what was asked for. The others say why the
interval is as wide as it is.

| reason | status | what was seen, and what to do |
|---|---|---|
"""


def reasons_page() -> str:
    """Returns the page as Markdown."""
    rows = [f"| `{reason}` | {'degraded' if reason.degrades else 'ok'} | {reason.sentence} |\n"
            for reason in Reason]
    return HEAD + "".join(rows)


if __name__ == "__main__":
    PAGE.write_text(reasons_page())
