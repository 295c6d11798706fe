# SPDX-License-Identifier: Apache-2.0
"""A scan of stored views in a fresh process, for its memory: imports nothing but the core."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.pipeline import StackCounter
from stack_counter.types import Intrinsics, View

_STEP_NS = 10**9  # between two views


def measure_stored_views(folder: Path, intrinsics: Intrinsics) -> dict[str, float]:
    """Measures the scan of the views in a folder, one file loaded at a time.

    A colour image comes with each.

    Args:
        folder: `*.npz` with `depth` ((h, w) uint16, mm) and `T_world_camera` (4, 4).
        intrinsics: calibration of all views.

    Returns:
        `long_views` used, `long_view_s` (median of `add_view`) and `long_finish_s`, seconds;
        `long_peak_mb` of the process, and `long_loaded_mb` before the first view.

    Raises:
        ScanError: the views give no V.
    """
    counter, loaded_mb, seconds = StackCounter(ReconstructorConfig()), peak_memory_mb(), []
    for i, path in enumerate(sorted(folder.glob("*.npz"))):
        with np.load(path) as file:
            depth = file["depth"].astype(np.float32) / 1000
            pose = file["T_world_camera"]
        color = np.full((*depth.shape, 3), 128, np.uint8)
        start = time.perf_counter()
        counter.add_view(View((i + 1) * _STEP_NS, intrinsics, pose, color, depth))
        seconds.append(time.perf_counter() - start)
    start = time.perf_counter()
    volume = counter.volume()
    return {"long_views": float(volume.views.used), "long_view_s": float(np.median(seconds)),
            "long_finish_s": time.perf_counter() - start, "long_peak_mb": peak_memory_mb(),
            "long_loaded_mb": loaded_mb}


def peak_memory_mb() -> float:
    """Largest resident size of this process so far, MB (Linux).

    Not from `getrusage`, whose maximum a process inherits from the one that started it.
    """
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024 / 1e6
    raise OSError("no VmHWM in /proc/self/status; expected Linux")
