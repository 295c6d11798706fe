# SPDX-License-Identifier: Apache-2.0
"""Counts damaged recordings, and says what each takes beside the healthy one.

    PYTHONPATH=test .venv/bin/python test/bag/damaged.py
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from kits.damaged_bags import DAMAGED, healthy

ROOT = Path(__file__).parents[2]


def replayed(path):
    """CPU-seconds, MB at most, exit code and the last line of `replay --direct`."""
    code = ("import resource, sys\nfrom stack_counter.cli import main\ncode = main(sys.argv[1:])\n"
            "used = resource.getrusage(resource.RUSAGE_SELF)\n"
            "print('USED', used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3, code)\n")
    done = subprocess.run(
        [sys.executable, "-c", code, "replay", str(path), "--direct", "--unit-volume-cm3", "5"],
        capture_output=True, text=True, cwd=ROOT, check=False)
    lines = done.stdout.strip().splitlines()
    seconds, memory, exit_code = lines[-1].removeprefix("USED ").split()
    said = done.stderr.strip().splitlines() if exit_code != "0" else lines[:1]
    assert exit_code in ("0", "3") and len(said) == 1, done
    return float(seconds), float(memory), exit_code, said[0]


def main():
    print(f"{'recording':42} exit  time  memory")
    whole = None
    for name, make in {"healthy": healthy, **DAMAGED}.items():
        with tempfile.TemporaryDirectory() as folder:
            seconds, memory, exit_code, said = replayed(make(Path(folder)))
        whole = whole or (seconds, memory)
        print(f"{name:42} {exit_code:>4}  {seconds / whole[0]:4.2f}  {memory / whole[1]:6.2f}  "
              f"{said.replace(folder, '')[:90]}", flush=True)
    print(f"healthy: {whole[0]:.1f} CPU-seconds, {whole[1]:.0f} MB")


if __name__ == "__main__":
    main()
