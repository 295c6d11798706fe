# SPDX-License-Identifier: Apache-2.0
"""Replays that end by a signal at a random moment; prints which of their processes go on.

    PYTHONPATH=test python test/nodes/killed.py [--runs 20] [--latest-s 22]
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

from kits.survivors import descendants, is_running

ROOT = Path(__file__).parents[2]
SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGKILL)
PATIENCE_S = 40.0  # of waiting for processes to end


def survivors_of(number: signal.Signals, after_s: float) -> tuple[int, set[int], set[int]]:
    """Replays the demo and ends it; returns exit code, its processes, and those that go on."""
    process = subprocess.Popen(
        [sys.executable, "-m", "stack_counter", "replay", "bags/demo", "--part", "demo_nut"],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    seen: set[int] = set()
    end = time.monotonic() + after_s
    while time.monotonic() < end and process.poll() is None:
        seen |= set(descendants(process.pid))
        time.sleep(0.1)
    seen |= set(descendants(process.pid))
    process.send_signal(number)
    code, end = process.wait(), time.monotonic() + PATIENCE_S
    while any(map(is_running, seen)) and time.monotonic() < end:
        time.sleep(0.1)
    return code, seen, {i for i in seen if is_running(i)}


def main() -> int:
    """Ends replays; returns 0 if no process of theirs goes on."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--latest-s", type=float, default=22.0,
                        help="time of the last signals, s: as long as a replay takes")
    options = parser.parse_args()
    chance, bad = random.Random(0), 0
    # Children of a job in the background would ignore it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in range(options.runs):
        ended_by, after_s = SIGNALS[number % len(SIGNALS)], chance.uniform(1.0, options.latest_s)
        begin = time.monotonic()
        code, seen, left = survivors_of(ended_by, after_s)
        bad += bool(left)
        print(f"run {number}: {ended_by.name} after {after_s:.1f} s, exit {code}, {len(seen)} "
              f"processes, left {sorted(left)}, waited {time.monotonic() - begin - after_s:.1f} s",
              flush=True)
    print(f"{options.runs - bad} of {options.runs} runs left nothing")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
