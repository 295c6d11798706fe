# SPDX-License-Identifier: Apache-2.0
"""STEP files, read in a process of their own: damaged ones may crash the library that reads."""

from __future__ import annotations

import os
import resource
import tempfile
from concurrent.futures import TimeoutError as TooLate
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from stack_counter.errors import MeshError
from stack_counter.tasks.child_processes import worker_pool

if TYPE_CHECKING:  # it loads SciPy, and the simulator's solids where they are installed
    import trimesh


@dataclass(frozen=True)
class StepFileSettings:
    """What the reader may take; all are chosen.

    Attributes:
        longest_s: time, seconds.
        most_bytes: memory.
    """

    longest_s: float = 300.0
    most_bytes: int = 8 * 10**9


SETTINGS = StepFileSettings()


def load_step(path: Path) -> trimesh.Trimesh | trimesh.Scene:
    """Reads the triangles of a STEP file, metres.

    Raises:
        MeshError: the reader has crashed, or takes too long or too much memory.
        Exception: the reader's own, of many kinds.
    """
    import trimesh

    with tempfile.TemporaryDirectory(prefix="stack_counter_") as folder:
        out = Path(folder) / "mesh.glb"
        try:
            with worker_pool(1) as pool:
                pool.submit(_convert, str(path), str(out)).result(SETTINGS.longest_s)
        except (BrokenProcessPool, TooLate) as error:
            said = "has crashed" if isinstance(error, BrokenProcessPool) \
                else f"has taken more than {SETTINGS.longest_s:g} s"
            raise MeshError(f"{path.name} cannot be read: the reader of STEP {said}; expected a "
                            "whole file of one part: write it anew, or as STL") from error
        if not out.is_file() or not out.stat().st_size:
            raise MeshError(f"{path.name} cannot be read: no solid is in it; expected a part")
        return trimesh.load_mesh(out, process=False, merge_primitives=True)


def _convert(path: str, out: str) -> None:
    """Writes the triangles of a STEP file as GLB; runs in a process of its own."""
    allowed = resource.getrlimit(resource.RLIMIT_AS)[1]
    if allowed == resource.RLIM_INFINITY or allowed > SETTINGS.most_bytes:
        resource.setrlimit(resource.RLIMIT_AS, (SETTINGS.most_bytes, allowed))
    # What the library prints is of its own making, and many lines.
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    import cascadio

    cascadio.step_to_glb(path, out)
