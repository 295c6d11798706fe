# SPDX-License-Identifier: Apache-2.0
"""Flat cuts through a part by CoACD, in a process of its own that may be lost.

The search of CoACD has no end for some meshes. It tells on its standard output how many pieces
wait before each round of cuts: their sum is the work done, the same on every machine and at any
load, and it ends here where the sum exceeds a budget. Rounds that hang inside themselves give no
such sign; they end after far more processor time than any search in budget was seen to take, so
that a slower machine ends the same meshes.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter.errors import StackCounterError
from stack_counter.tasks.child_processes import ENDS_WITH_STDIN


class CutterError(StackCounterError):
    """The process that cuts a part died of something that is not the mesh's."""


@dataclass(frozen=True)
class FlatCutSettings:
    """The search for each cut, and its budget.

    Attributes:
        mcts_iterations, mcts_nodes, mcts_max_depth, resolution: the search that CoACD makes for
            each cut: a sixth of its defaults, with pieces as full.
        max_cuts: pieces that it may try to cut, all rounds together; a part of n pieces takes
            about 2 n. Chosen.
        guard_cpu_s: processor seconds after which a round is taken as endless.
    """

    mcts_iterations: int = 25
    mcts_nodes: int = 10
    mcts_max_depth: int = 2
    resolution: int = 600
    max_cuts: int = 150
    guard_cpu_s: int = 120


SETTINGS = FlatCutSettings()
_CUTTER = Path(__file__).with_name("flat_cutter.py")
# Exit codes: beyond the budget, beyond the guard, and CoACD's own crashes
_TOO_MANY_CUTS = 3  # as in `flat_cutter`
_ENDS_OF_A_MESH = (_TOO_MANY_CUTS, -signal.SIGXCPU, -signal.SIGSEGV, -signal.SIGABRT,
                   -signal.SIGFPE)


def cut_flat(vertices: np.ndarray, faces: np.ndarray, threshold: float) -> list[np.ndarray]:
    """Corners (n, 3) of the pieces of a solid; none if the search did not end in its budget.

    Args:
        vertices: (n, 3) float64, metres.
        faces: (m, 3) int32, counter-clockwise from outside.
        threshold: concavity that a piece may keep.

    Raises:
        CutterError: the process died of something that is not the mesh's.
    """
    request = {"vertices": vertices.tolist(), "faces": faces.tolist(),
               "max_cuts": SETTINGS.max_cuts, "guard_cpu_s": SETTINGS.guard_cpu_s,
               "search": {"threshold": threshold, "mcts_iterations": SETTINGS.mcts_iterations,
                          "mcts_nodes": SETTINGS.mcts_nodes,
                          "mcts_max_depth": SETTINGS.mcts_max_depth,
                          "resolution": SETTINGS.resolution}}
    # One thread: with more of them the order of the pieces, and so their merging, is a matter of
    # luck. Its imports are found where ours are, and not beside its file.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", ENDS_WITH_STDIN: "1",
                   "PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(map(os.path.abspath,
                                                                            sys.path))}
    with subprocess.Popen([sys.executable, str(_CUTTER)], env=environment, stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as process:
        try:
            # Its stdin stays open until it has ended: it ends with us.
            answer, _ = _ask(process, json.dumps(request)), process.wait()
        except BaseException:  # an interruption
            process.kill()
            raise
    # What depends on the mesh alone is no error; all else would give other pieces another time.
    if process.returncode in _ENDS_OF_A_MESH:
        return []
    if process.returncode:
        raise CutterError(f"the process that cuts a part ended with {process.returncode}; "
                          f"expected 0 or one of {sorted(_ENDS_OF_A_MESH)}: see its own error")
    return [np.array(corners) for corners in json.loads(answer)]


def _ask(process: subprocess.Popen[str], line: str) -> str:
    """What a process writes to its end when it has read a line; empty if it reads none."""
    assert process.stdin and process.stdout  # for the type checker: both are pipes
    try:
        process.stdin.write(line + "\n")
        process.stdin.flush()
    except BrokenPipeError:
        return ""
    return process.stdout.read()
