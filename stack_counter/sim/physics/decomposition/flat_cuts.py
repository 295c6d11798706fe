# SPDX-License-Identifier: Apache-2.0
"""Flat cuts through a part by CoACD, in a process of its own that may be lost.

The search of CoACD has no end for some meshes. It tells on its standard output how many pieces
wait before each round of cuts: their sum is the work done, the same on every machine and at any
load, and it ends here where the sum exceeds a budget. Rounds that hang inside themselves give no
such sign; they end after far more processor time than any search in budget was seen to take, so
that a slower machine ends the same meshes.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import resource
import signal
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from stack_counter.child_processes import end_with_parent


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
# Exit codes: beyond the budget, beyond the guard, and CoACD's own crashes
_TOO_MANY_CUTS = 3
_ENDS_OF_A_MESH = (_TOO_MANY_CUTS, -signal.SIGXCPU, -signal.SIGSEGV, -signal.SIGABRT,
                   -signal.SIGFPE)
_WAITING = re.compile(rb"waiting pool: (\d+)")


def cut_flat(vertices: np.ndarray, faces: np.ndarray, threshold: float) -> list[np.ndarray]:
    """Corners (n, 3) of the pieces of a solid; none if the search did not end in its budget.

    Args:
        vertices: (n, 3) float64, metres.
        faces: (m, 3) int32, counter-clockwise from outside.
        threshold: concavity that a piece may keep.

    Raises:
        RuntimeError: the process died of something that is not the mesh's.
    """
    # From a server without threads: a fork of this process would inherit those of its libraries.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send_pieces,
                              args=(vertices, faces, threshold, SETTINGS, sender))
    process.start()
    sender.close()
    pieces: list[np.ndarray] = []
    try:
        pieces = receiver.recv()
    except EOFError:
        pass  # it ended without: why, its exit code says
    except BaseException:  # an interruption
        process.kill()
        raise
    finally:
        receiver.close()
        process.join()
    # What depends on the mesh alone is no error; all else would give other pieces another time.
    if not pieces and process.exitcode not in _ENDS_OF_A_MESH:
        raise RuntimeError(f"the process that cuts a part ended with {process.exitcode}; expected "
                           f"0 or one of {sorted(_ENDS_OF_A_MESH)}: see its own error")
    return pieces


def _send_pieces(vertices: np.ndarray, faces: np.ndarray, threshold: float,
                 settings: FlatCutSettings, sender: Connection) -> None:
    """Cuts a solid and sends the pieces' corners; this process ends where it takes too much."""
    end_with_parent()
    resource.setrlimit(resource.RLIMIT_CPU, (settings.guard_cpu_s, settings.guard_cpu_s + 5))
    counting = _end_after_cuts(settings.max_cuts)
    # One thread: with more of them the order of the pieces, and so their merging, is a matter of
    # luck.
    os.environ["OMP_NUM_THREADS"] = "1"
    import coacd  # here: only this needs it

    coacd.set_log_level("info")
    pieces: list[tuple[np.ndarray, Any]] = coacd.run_coacd(
        coacd.Mesh(vertices, faces), threshold=threshold, preprocess_mode="off",
        mcts_iterations=settings.mcts_iterations, mcts_nodes=settings.mcts_nodes,
        mcts_max_depth=settings.mcts_max_depth, resolution=settings.resolution)
    # All that was told is counted before the pieces are taken, however late the other thread is.
    os.close(1)
    counting.join()
    sender.send([np.asarray(corners, np.float64) for corners, _ in pieces])


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
                    os._exit(_TOO_MANY_CUTS)

    thread = threading.Thread(target=count_cuts, daemon=True)
    thread.start()
    return thread
