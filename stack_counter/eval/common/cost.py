"""What a count costs: seconds a view against bare Open3D, seconds to V, memory of a long scan."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import open3d as o3d
import open3d.core as o3c

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, StackCounterError
from stack_counter.eval.common import long_scan
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, record
from stack_counter.types import Intrinsics, View

LARGE = Intrinsics(1280, 720, 915.0, 915.0, 639.5, 359.5)
_LONG = 60  # views of the long scan
_FIRST = 3  # views after which the region is known
_VOXEL_M = 0.002  # of both
_ROUNDS = 3  # of which the fastest counts: the machine may be shared
# Open3D's own defaults: blocks of 16 voxels, sdf_trunc of 8.
_BARE = {"bare_s": (16, 8.0), "bare_our_blocks_s": (8, ReconstructorConfig().trunc_voxels)}


def cost_of_views(views: list[View]) -> dict[str, float]:
    """Median seconds a view: `fused_s` of `add_view` with the region known, `bare_s` and
    `bare_our_blocks_s` of Open3D's whole-frame `integrate` with its defaults and with our block
    size and truncation; and `finish_s` from the last view to V. Of each step the fastest of
    three rounds counts.

    Raises:
        ScanError: no V.
    """
    config = ReconstructorConfig(voxel_size=_VOXEL_M)
    rounds = [{"fused_s": _seconds(StackCounter(config).add_view, views),
               **{name: _seconds(_bare(*how), views) for name, how in _BARE.items()},
               "finish_s": _finish(views)} for _ in range(_ROUNDS)]
    return {name: float(np.median(np.min([r[name] for r in rounds], axis=0)))
            for name in rounds[0]}


def _seconds(step: Callable[[View], None], views: list[View]) -> list[float]:
    """Of each view but the first few."""
    seconds = []
    for view in views:
        start = time.perf_counter()
        step(view)
        seconds.append(time.perf_counter() - start)
    return seconds[_FIRST:]


def _bare(block: int, trunc: float) -> Callable[[View], None]:
    config = ReconstructorConfig(voxel_size=_VOXEL_M)
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (o3c.float32, o3c.float32), [o3c.SizeVector([1])] * 2,
        config.voxel_size, block, 20_000, o3c.Device("CPU:0"))

    def integrate(view: View) -> None:
        K = o3c.Tensor(view.intrinsics.K)
        T_camera_world = o3c.Tensor(geometry.inverse(view.T_world_camera))
        image = o3d.t.geometry.Image(o3c.Tensor(view.depth))
        how = (K, T_camera_world, 1.0, config.depth_trunc, trunc)
        grid.integrate(grid.compute_unique_block_coordinates(image, *how), image, *how)

    return integrate


def _finish(views: list[View]) -> list[float]:
    stack = StackCounter(ReconstructorConfig(voxel_size=_VOXEL_M))
    for view in views:
        stack.add_view(view)
    start = time.perf_counter()
    stack.volume()
    return [time.perf_counter() - start]


def cost_of_long_scan(scene: Scene, seed: int, views: int = _LONG, k: Intrinsics = LARGE
                      ) -> dict[str, float]:
    """See `long_scan.count_files`; the scan of many large views runs in a process of its own.

    Raises:
        ScanError: no V.
    """
    with tempfile.TemporaryDirectory() as folder:
        taken = record(scene, views, seed, color=False, intrinsics=k)
        for i, view in enumerate(taken):
            np.savez(Path(folder) / f"{i:03d}.npz", depth=np.round(1000 * view.depth).astype(
                np.uint16), T_world_camera=view.T_world_camera)
        del taken
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            return pool.submit(long_scan.count_files, Path(folder), k).result()


def measure(scenes: list[tuple[Scene, list[View]]], seed: int) -> dict[str, float]:
    """Means over scenes of `cost_of_views`, the slowest way to V, and a long scan of the first.

    Raises:
        ScanError: V of none of them is found.
    """
    rows = []
    for _, views in scenes:
        try:
            rows.append(cost_of_views(views))
        except StackCounterError:
            continue  # counted where V is compared
    if not rows:
        raise ScanError(f"{len(scenes)} scenes and V of none; expected one at least")
    return {**{name: float(np.mean([r[name] for r in rows])) for name in rows[0]},
            "finish_slowest_s": max(r["finish_s"] for r in rows),
            **cost_of_long_scan(scenes[0][0], seed)}


def text(cost: dict[str, float]) -> str:
    """The figures with their targets, as lines."""
    share = cost["fused_s"] / cost["bare_s"]
    return (
        f"one view of 640x480 fused: {cost['fused_s']:.4f} s; bare Open3D, whole frame: "
        f"{cost['bare_s']:.4f} s ({share:.0%} of it; target at most 50%), with our blocks and "
        f"truncation {cost['bare_our_blocks_s']:.4f} s\n"
        f"last view to V: mean {cost['finish_s']:.2f} s, slowest scene "
        f"{cost['finish_slowest_s']:.2f} s (target 0.7 s)\n"
        f"{cost['long_views']:.0f} views of {LARGE.width}x{LARGE.height}: peak "
        f"{cost['long_peak_mb']:.0f} MB (target below 1500; {cost['long_loaded_mb']:.0f} of it "
        f"libraries), {cost['long_view_s']:.3f} s a view (median), {cost['long_finish_s']:.2f} s "
        "to V")
