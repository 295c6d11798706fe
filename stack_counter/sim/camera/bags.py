"""Writes recordings of simulated scenes as a robot cell would make them, with their truth.

`truth.json` in the bag's folder holds count, v, V, gamma and how the scene was made; of a
sequence of picks also the count at every stamp. Beside an arm's recording lies the part's mesh.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from stack_counter import geometry
from stack_counter.bag.writer import Transform, write_bag, write_rig_bag
from stack_counter.errors import BagError
from stack_counter.sim.camera.recording import FRAME, record, record_fixed_camera, record_station
from stack_counter.sim.physics.table import lay_out_pieces
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import View

_TF_STEP_NS = 20_000_000  # 50 Hz
_REST = 2  # samples of /tf around an exposure in which the arm rests
PART_MESH = "part.stl"  # the part in millimetres, beside the bag's files
_MOST_SPREAD = 36  # pieces on a table
_DEAD_CYCLE = 2  # in which one of a station's cameras gives nothing
_LATENCY_NS = 7_000_000  # of the arm's poses against the images


def write_scene_bag(scene: Scene, out: Path, views: int, seed: int) -> None:
    """A moving camera looks at the scene from an arc of views.

    Raises:
        BagError: `out` exists, or too few views.
    """
    if not 3 <= views <= 200:
        raise BagError(f"{views} views; expected 3 to 200")
    taken = record(scene, views, seed)
    write_bag(out, taken, arm_transforms(taken))
    _write_truth(out, scene, seed, {})
    solid = scene.shape.mesh.copy()
    solid.apply_scale(1000).export(out / PART_MESH)


def write_spread_bag(scene: Scene, out: Path, pieces: int, views: int, seed: int) -> None:
    """A moving camera looks at so many pieces of the scene's part that lie apart on a table.

    Raises:
        BagError: as `write_scene_bag`, or too many pieces.
    """
    if not 1 <= pieces <= _MOST_SPREAD:
        raise BagError(f"{pieces} pieces; expected 1 to {_MOST_SPREAD}")
    write_scene_bag(lay_out_pieces(scene.shape, pieces, seed, scene.index), out, views, seed)


def write_picks_bag(scene: Scene, out: Path, picks: int, seed: int) -> None:
    """A fixed camera sees one part more gone at every stamp, from the top.

    Raises:
        BagError: `out` exists, or more picks than parts.
    """
    if not 1 <= picks <= len(scene.poses):
        raise BagError(f"{picks} picks from {len(scene.poses)} parts; expected 1 to that many")
    states = list(remove_parts(scene, picks))
    views = record_fixed_camera(states, seed)
    mount: Transform = (views[0].stamp_ns, "base_link", FRAME, views[0].T_world_camera)
    write_bag(out, views, transforms=(), static=[mount])
    counts = [{"stamp_ns": view.stamp_ns, "count": len(state.poses)}
              for view, state in zip(views, states)]
    _write_truth(out, states[-1], seed, {"counts": counts})


def write_station_bag(scene: Scene, out: Path, cycles: int, seed: int) -> None:
    """Four fixed cameras see the bin once a cycle, each time with fewer parts; in the third cycle
    one of them is dead. Beside the bag's files lies the rig file.

    Raises:
        BagError: `out` exists, or more cycles than parts.
    """
    if not 1 <= cycles <= len(scene.poses):
        raise BagError(f"{cycles} cycles with {len(scene.poses)} parts; expected 1 to that many")
    left = [round(len(scene.poses) * (1 - k / cycles)) for k in range(cycles)]
    states = list(remove_parts(scene, len(scene.poses) - left[-1]))
    shown = [next(s for s in states if len(s.poses) == n) for n in left]
    cameras = record_station(shown, seed=seed)
    static: list[Transform] = [(views[0].stamp_ns, "base_link", views[0].camera,
                                views[0].T_world_camera) for views in cameras.values()]
    counts = [{"stamp_ns": max(v[k].stamp_ns for v in cameras.values()), "count": n}
              for k, n in enumerate(left)]
    dead = list(cameras)[-1]
    poses = {name: views[0].T_world_camera for name, views in cameras.items()}
    cameras[dead] = [view for k, view in enumerate(cameras[dead]) if k != _DEAD_CYCLE]
    # Two cameras are known to TF, two to the rig file.
    known = dict(list(poses.items())[len(poses) // 2:])
    write_rig_bag(out, cameras, static[:len(poses) // 2])
    (out / "rig.yaml").write_text(yaml.safe_dump(_rig(cameras, known), sort_keys=False))
    _write_truth(out, shown[-1], seed, {"counts": counts})


def _rig(cameras: dict[str, list[View]], poses: dict[str, np.ndarray]) -> dict:
    body: dict = {}
    for name in cameras:
        body[name] = {"color_topic": f"/{name}/color/image_raw", "color_transport": "compressed",
                      "camera_info_topic": f"/{name}/color/camera_info",
                      "depth_topic": f"/{name}/aligned_depth_to_color/image_raw"}
        if name in poses:
            body[name]["pose"] = {
                "xyz_m": [round(float(x), 6) for x in poses[name][:3, 3]],
                "quaternion_xyzw": [round(float(q), 8) for q in
                                    geometry.quaternion_from_pose(poses[name])]}
    return {"cameras": body, "trigger": {"tolerance_s": 0.05, "timeout_s": 0.5}}


def remove_parts(scene: Scene, picks: int) -> Iterator[Scene]:
    """The scene, and after each pick what is left of it.

    The part that reaches highest is taken. What leaned on it, or lay on its lower end, stays as
    it was: the engine is not asked again.
    """
    vertices = scene.parts_mesh().vertices
    order = np.argsort(vertices[:, 2].reshape(len(scene.poses), -1).max(axis=1))
    for taken in range(picks + 1):
        left = np.sort(order[:len(order) - taken])
        yield replace(scene, poses=scene.poses[left], stored_truth=None)


def arm_transforms(views: list[View], world_frame: str = "base_link") -> list[Transform]:
    """/tf of the arm at 50 Hz: in rest around each exposure, moving in between."""
    out: list[Transform] = []
    still = _REST * _TF_STEP_NS
    for before, after in zip(views, views[1:] + views[-1:]):
        last = after.stamp_ns - still if after is not before else before.stamp_ns + still + 1
        for stamp in range(before.stamp_ns - still, last, _TF_STEP_NS):
            way = max(after.stamp_ns - before.stamp_ns - 2 * still, 1)
            share = float(np.clip((stamp - before.stamp_ns - still) / way, 0, 1))
            T = geometry.interpolate(before.T_world_camera, after.T_world_camera, share)
            out.append((stamp + _LATENCY_NS, world_frame, FRAME, T))
    return out


def _write_truth(bag: Path, scene: Scene, seed: int, more: dict) -> None:
    truth, container = scene.truth, scene.container
    (bag / "truth.json").write_text(json.dumps({
        "count": truth.count, "unit_volume_cm3": truth.unit_volume * 1e6,
        "volume_m3": truth.stack_volume, "gamma": truth.gamma if truth.count else None,
        "family": scene.shape.family,
        "part_size_m": scene.shape.part_size, "container": container.kind,
        "inner_size_m": container.inner_size_m, "wall_thickness_m": container.wall_thickness_m,
        "floor_thickness_m": container.floor_thickness_m,
        "scene": {"seed": scene.seed, "index": scene.index}, "seed": seed, **more},
        indent=2) + "\n")
