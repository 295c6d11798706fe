# SPDX-License-Identifier: Apache-2.0
"""The process that `flat_cuts` starts: reads a part from stdin, writes its pieces to stdout.

It runs as a file, and loads numpy and CoACD alone: the package around it would take seconds.
"""

from __future__ import annotations

import json
import os
import re
import resource
import sys
import threading

import coacd
import numpy as np

from stack_counter.tasks.child_processes import end_with_parent

TOO_MANY_CUTS = 3  # exit code, as in `flat_cuts`
_WAITING = re.compile(rb"waiting pool: (\d+)")


def main() -> None:
    """Cuts one solid; this process ends where that takes too much."""
    request = json.loads(sys.stdin.readline())
    end_with_parent()
    guard_s = request["guard_cpu_s"]
    resource.setrlimit(resource.RLIMIT_CPU, (guard_s, guard_s + 5))
    # What CoACD tells goes where it is counted, the pieces to where stdout was.
    with os.fdopen(os.dup(1), "w") as answer:
        counting = _end_after_cuts(request["max_cuts"])
        coacd.set_log_level("info")
        pieces = coacd.run_coacd(
            coacd.Mesh(np.array(request["vertices"], np.float64),
                       np.array(request["faces"], np.int32)),
            preprocess_mode="off", **request["search"])
        # All that was told is counted before the pieces are given, however late the thread is.
        os.close(1)
        counting.join()
        json.dump([np.asarray(corners, np.float64).tolist() for corners, _ in pieces], answer)


def _end_after_cuts(most: int) -> threading.Thread:
    """A thread that reads this process's standard output, and ends it beyond the budget."""
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)

    def count_cuts() -> None:
        cuts = 0
        with os.fdopen(reading, "rb") as lines:
            for line in lines:
                waiting = _WAITING.search(line)
                cuts += int(waiting[1]) if waiting else 0
                if cuts > most:
                    os._exit(TOO_MANY_CUTS)

    thread = threading.Thread(target=count_cuts, daemon=True)
    thread.start()
    return thread


if __name__ == "__main__":
    main()
