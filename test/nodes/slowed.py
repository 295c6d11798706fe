# SPDX-License-Identifier: Apache-2.0
"""The station's recording through nodes that stand still in bursts; prints what was counted.

    PYTHONPATH=test python test/nodes/slowed.py [--runs 20] [--longest-s 6]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from kits.survivors import descendants, is_running

ROOT = Path(__file__).parents[2]
TRUTH = json.loads((ROOT / "bags" / "station" / "truth.json").read_text())


def replay(out: Path, longest_s: float, seed: int) -> subprocess.Popen:
    """Replays the station and stops its nodes at random until it ends; returns it."""
    chance = random.Random(seed)
    process = subprocess.Popen(
        [sys.executable, "-m", "stack_counter", "replay", "bags/station", "--config",
         "config/station.yaml", "--unit-volume-cm3", str(TRUTH["unit_volume_cm3"]), "--json",
         str(out)], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    while process.poll() is None:
        time.sleep(chance.uniform(0.0, 1.5))
        nodes = [i for i in descendants(process.pid) if is_running(i)]
        if not nodes:
            continue
        stopped = chance.sample(nodes, chance.randint(1, len(nodes)))
        for signal_number in (signal.SIGSTOP, signal.SIGCONT):
            for node in stopped:
                try:
                    os.kill(node, signal_number)
                except ProcessLookupError:
                    pass
            if signal_number == signal.SIGSTOP:
                time.sleep(chance.uniform(0.1, longest_s))
    return process


def main() -> int:
    """Replays; returns 0 if every cycle of every run was counted from all its cameras."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--longest-s", type=float, default=6.0, help="of one standstill, s")
    options = parser.parse_args()
    expected = [None, None, ["back"], None, None]  # one camera is dead in the third cycle
    whole = 0
    for number in range(options.first, options.first + options.runs):
        with tempfile.TemporaryDirectory() as folder:
            out, begin = Path(folder) / "result.json", time.monotonic()
            process = replay(out, options.longest_s, number)
            counts = json.loads(out.read_text())["counts"] if out.exists() else []
        missing = [entry.get("missing_cameras") for entry in counts]
        whole += missing == expected
        print(f"run {number}: exit {process.returncode}, {len(counts)} cycles, without {missing}, "
              f"{time.monotonic() - begin:.0f} s", flush=True)
        if missing != expected and process.stdout is not None:
            print(process.stdout.read(), flush=True)
    print(f"{whole} of {options.runs} runs whole")
    return int(whole < options.runs)


if __name__ == "__main__":
    sys.exit(main())
