# SPDX-License-Identifier: Apache-2.0
"""What a count costs: seconds a view against bare Open3D, seconds to V, memory of a long scan."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, StackCounterError
from stack_counter.eval.common import long_scan
from stack_counter.lean_open3d import o3c, o3d
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, record
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.types import Intrinsics, View


@dataclass(frozen=True)
class CostSettings:
    """What is timed; chosen.

    Attributes:
        voxel_m: voxel size of both.
        first_views: number of views after which the region is known.
        rounds: number of rounds of which the fastest counts: the machine may be shared.
        long_views, long_camera: views of the long scan, and their camera.
    """

    voxel_m: float = 0.002
    first_views: int = 3
    rounds: int = 3
    long_views: int = 60
    long_camera: Intrinsics = Intrinsics(1280, 720, 915.0, 915.0, 639.5, 359.5)


SETTINGS = CostSettings()
# Voxels along a block and truncation in voxels: Open3D's own defaults, and ours.
_BARE = {"bare_s": (16, 8.0), "bare_our_blocks_s": (8, ReconstructorConfig().trunc_voxels)}


def measure_view_cost(views: list[View]) -> dict[str, float]:
    """Measures median seconds a view.

    `fused_s` of `add_view` with the region known, `bare_s` and `bare_our_blocks_s` of Open3D's
    whole-frame `integrate` with its defaults and with our block size and truncation; and
    `finish_s` from the last view to V. Of each step the fastest of three rounds counts.

    Raises:
        ScanError: the views give no V.
    """
    config = ReconstructorConfig(voxel_size=SETTINGS.voxel_m)
    rounds = [{"fused_s": _time_views(StackCounter(config).add_view, views),
               **{name: _time_views(_bare_integrate(*blocks), views)
                  for name, blocks in _BARE.items()},
               "finish_s": [_time_finish(views)]} for _ in range(SETTINGS.rounds)]
    return {name: float(np.median(np.min([r[name] for r in rounds], axis=0)))
            for name in rounds[0]}


def _time_views(process: Callable[[View], None], views: list[View]) -> list[float]:
    """Seconds that each view but the first few takes."""
    seconds = []
    for view in views:
        start = time.perf_counter()
        process(view)
        seconds.append(time.perf_counter() - start)
    return seconds[SETTINGS.first_views:]


def _bare_integrate(block: int, trunc_voxels: float) -> Callable[[View], None]:
    """Open3D's `integrate` of a whole view into an empty grid."""
    config = ReconstructorConfig(voxel_size=SETTINGS.voxel_m)
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (o3c.float32, o3c.float32), [o3c.SizeVector([1])] * 2,
        config.voxel_size, block, 20_000, o3c.Device("CPU:0"))

    def integrate(view: View) -> None:
        K = o3c.Tensor(view.intrinsics.K)
        T_camera_world = o3c.Tensor(geometry.inverse(view.T_world_camera))
        image = o3d.t.geometry.Image(o3c.Tensor(view.depth))
        camera = (K, T_camera_world, 1.0, config.depth_trunc, trunc_voxels)
        grid.integrate(grid.compute_unique_block_coordinates(image, *camera), image, *camera)

    return integrate


def _time_finish(views: list[View]) -> float:
    """Seconds from the last view to V."""
    counter = StackCounter(ReconstructorConfig(voxel_size=SETTINGS.voxel_m))
    for view in views:
        counter.add_view(view)
    start = time.perf_counter()
    counter.volume()
    return time.perf_counter() - start


def measure_long_scan_cost(scene: Scene, seed: int) -> dict[str, float]:
    """Measures a scan of many large views in a process of its own.

    The figures are those of `long_scan.measure_stored_views`.

    Raises:
        ScanError: the views give no V.
    """
    with tempfile.TemporaryDirectory() as folder:
        recorded = record(scene, SETTINGS.long_views, seed, color=False,
                          intrinsics=SETTINGS.long_camera)
        for i, view in enumerate(recorded):
            assert view.depth is not None  # recordings have depth
            np.savez(Path(folder) / f"{i:03d}.npz", depth=np.round(1000 * view.depth).astype(
                np.uint16), T_world_camera=view.T_world_camera)
        del recorded
        with worker_pool(1) as pool:
            return pool.submit(long_scan.measure_stored_views, Path(folder),
                               SETTINGS.long_camera).result()


def measure_cost(recordings: list[tuple[Scene, list[View]]], seed: int) -> dict[str, float]:
    """Measures means over scenes of `measure_view_cost`, the slowest way to V, and a long scan.

    The long scan is of the first scene.

    Raises:
        ScanError: V of none of them is found.
    """
    rows = []
    for _, views in recordings:
        try:
            rows.append(measure_view_cost(views))
        except StackCounterError:
            continue  # counted where V is compared
    if not rows:
        raise ScanError(f"{len(recordings)} scenes and V of none; expected one at least")
    return {**{name: float(np.mean([r[name] for r in rows])) for name in rows[0]},
            "finish_slowest_s": max(r["finish_s"] for r in rows),
            **measure_long_scan_cost(recordings[0][0], seed)}


def format_cost(cost: dict[str, float]) -> str:
    """The figures with their targets, as lines."""
    share, camera = cost["fused_s"] / cost["bare_s"], SETTINGS.long_camera
    return (
        f"one view of 640x480 fused: {cost['fused_s']:.4f} s; bare Open3D, whole frame: "
        f"{cost['bare_s']:.4f} s ({share:.0%} of it; target at most 50%), with our blocks and "
        f"truncation {cost['bare_our_blocks_s']:.4f} s\n"
        f"last view to V: mean {cost['finish_s']:.2f} s, slowest scene "
        f"{cost['finish_slowest_s']:.2f} s (target 0.7 s)\n"
        f"{cost['long_views']:.0f} views of {camera.width}x{camera.height}: peak "
        f"{cost['long_peak_mb']:.0f} MB (target below 1500; {cost['long_loaded_mb']:.0f} of it "
        f"libraries), {cost['long_view_s']:.3f} s a view (median), {cost['long_finish_s']:.2f} s "
        "to V")
