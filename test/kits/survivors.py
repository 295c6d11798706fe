# SPDX-License-Identifier: Apache-2.0
"""Processes that should have ended."""

import threading
import time
from pathlib import Path


def descendants(process_id):
    """Ids of a process's children, of theirs, and so on."""
    found = []
    for task in Path(f"/proc/{process_id}/task").glob("*/children"):
        try:
            children = [int(child) for child in task.read_text().split()]
        except OSError:  # the thread has ended
            continue
        for child in children:
            found += [child, *descendants(child)]
    return found


def is_running(process_id):
    """Whether there is such a process and it is no zombie, whom nobody has waited for."""
    try:
        status = Path(f"/proc/{process_id}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] not in "ZX"


def wait_until(condition, what, seconds=60.0):
    """Waits until the condition holds; fails the test where it does not in time."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited {seconds} s for {what}"
        threading.Event().wait(0.05)


def wait_for_end(process_ids):
    """Waits until the processes have ended; fails the test where they do not in time."""
    wait_until(lambda: not any(map(is_running, process_ids)), f"processes {process_ids} to end")
