# SPDX-License-Identifier: Apache-2.0
"""Writes recordings of simulated scenes as a robot cell would make them, with their truth.

`truth.json` in the bag's folder holds count, v, V, gamma and how the scene was made; of a
sequence of picks also the count at every stamp. Beside an arm's recording lies the part's mesh.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
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

# File of the part in millimetres, beside the bag's own.
PART_MESH = "part.stl"


@dataclass(frozen=True)
class BagSettings:
    """What a simulated cell publishes; all chosen.

    Attributes:
        tf_step_ns: time between two transforms: 50 Hz.
        rest_steps: transforms before and after an exposure in which the arm rests.
        latency_ns: delay of the arm's poses against the images.
        views: fewest and most views of an arm's recording.
        max_pieces: largest number of pieces on a table.
        dead_cycle: cycle, from 0, in which one of a station's cameras gives nothing.
    """

    tf_step_ns: int = 20_000_000
    rest_steps: int = 2
    latency_ns: int = 7_000_000
    views: tuple[int, int] = (3, 200)
    max_pieces: int = 36
    dead_cycle: int = 2


SETTINGS = BagSettings()


def write_scene_bag(scene: Scene, out: Path, views: int, seed: int) -> None:
    """Records the scene by a moving camera from an arc of views.

    Raises:
        BagError: `out` exists, or too few or too many views.
    """
    fewest, most = SETTINGS.views
    if not fewest <= views <= most:
        raise BagError(f"{views} views; expected {fewest} to {most}")
    recorded = record(scene, views, seed)
    write_bag(out, recorded, arm_transforms(recorded))
    _write_truth(out, scene, seed, {})
    solid = scene.shape.mesh.copy()
    solid.apply_scale(1000).export(out / PART_MESH)


def write_spread_bag(scene: Scene, out: Path, pieces: int, views: int, seed: int) -> None:
    """Records pieces of the scene's part that lie apart on a table by a moving camera.

    Raises:
        BagError: `out` exists, too few or too many views, or too many pieces.
    """
    if not 1 <= pieces <= SETTINGS.max_pieces:
        raise BagError(f"{pieces} pieces; expected 1 to {SETTINGS.max_pieces}")
    write_scene_bag(lay_out_pieces(scene.shape, pieces, seed, scene.index), out, views, seed)


def write_picks_bag(scene: Scene, out: Path, picks: int, seed: int) -> None:
    """Records by a fixed camera how one part after the other is taken from the top.

    Raises:
        BagError: `out` exists, or more picks than parts.
    """
    if not 1 <= picks <= len(scene.poses):
        raise BagError(f"{picks} picks from {len(scene.poses)} parts; expected 1 to that many")
    states = list(remove_parts(scene, picks))
    views = record_fixed_camera(states, seed)
    mount = Transform(views[0].stamp_ns, "base_link", FRAME, views[0].T_world_camera)
    write_bag(out, views, transforms=(), static=[mount])
    counts = [{"stamp_ns": view.stamp_ns, "count": len(state.poses)}
              for view, state in zip(views, states)]
    _write_truth(out, states[-1], seed, {"counts": counts})


def write_station_bag(scene: Scene, out: Path, cycles: int, seed: int) -> None:
    """Records the bin by four fixed cameras once a cycle, each time with fewer parts.

    In the third cycle one of them is dead. Beside the bag's files lies the rig file.

    Raises:
        BagError: `out` exists, or more cycles than parts.
    """
    if not 1 <= cycles <= len(scene.poses):
        raise BagError(f"{cycles} cycles with {len(scene.poses)} parts; expected 1 to that many")
    # A state of the scene for each cycle
    remaining = [round(len(scene.poses) * (1 - k / cycles)) for k in range(cycles)]
    states = list(remove_parts(scene, len(scene.poses) - remaining[-1]))
    cycle_states = [next(s for s in states if len(s.poses) == n) for n in remaining]
    cameras = record_station(cycle_states, seed=seed)
    # Truth and poses, before a camera dies
    counts = [{"stamp_ns": max(views[k].stamp_ns for views in cameras.values()), "count": n}
              for k, n in enumerate(remaining)]
    static = [Transform(views[0].stamp_ns, "base_link", views[0].camera, views[0].T_world_camera)
              for views in cameras.values()]
    poses = {name: views[0].T_world_camera for name, views in cameras.items()}
    dead = list(cameras)[-1]
    cameras[dead] = [view for k, view in enumerate(cameras[dead]) if k != SETTINGS.dead_cycle]
    # The poses of half of the cameras are in TF, those of the others in the rig file
    in_tf = len(poses) // 2
    write_rig_bag(out, cameras, static[:in_tf])
    rig = _rig_description(list(cameras), dict(list(poses.items())[in_tf:]))
    (out / "rig.yaml").write_text(yaml.safe_dump(rig, sort_keys=False))
    _write_truth(out, cycle_states[-1], seed, {"counts": counts})


def _rig_description(names: list[str], poses: dict[str, np.ndarray]) -> dict:
    """A rig file's content: topics of all cameras, and the poses (4, 4) of some."""
    cameras: dict = {}
    for name in names:
        cameras[name] = {"color_topic": f"/{name}/color/image_raw",
                         "color_transport": "compressed",
                         "camera_info_topic": f"/{name}/color/camera_info",
                         "depth_topic": f"/{name}/aligned_depth_to_color/image_raw"}
        if name in poses:
            quaternion = geometry.quaternion_from_pose(poses[name])
            cameras[name]["pose"] = {
                "xyz_m": [round(float(x), 6) for x in poses[name][:3, 3]],
                "quaternion_xyzw": [round(float(q), 8) for q in quaternion]}
    return {"cameras": cameras, "trigger": {"tolerance_s": 0.05, "timeout_s": 0.5}}


def remove_parts(scene: Scene, picks: int) -> Iterator[Scene]:
    """The scene, and after each pick what is left of it.

    The part that reaches highest is taken. What leaned on it, or lay on its lower end, stays as
    it was: the physics is not simulated again.
    """
    vertices = scene.parts_mesh().vertices
    order = np.argsort(vertices[:, 2].reshape(len(scene.poses), -1).max(axis=1))
    for taken in range(picks + 1):
        remaining = np.sort(order[:len(order) - taken])
        yield replace(scene, poses=scene.poses[remaining], stored_truth=None)


def arm_transforms(views: list[View], world_frame: str = "base_link") -> list[Transform]:
    """/tf of the arm at 50 Hz: in rest around each exposure, moving in between."""
    transforms: list[Transform] = []
    rest_ns = SETTINGS.rest_steps * SETTINGS.tf_step_ns
    for view, following in zip(views, views[1:] + views[-1:]):
        end = following.stamp_ns - rest_ns if following is not view \
            else view.stamp_ns + rest_ns + 1
        moving_ns = max(following.stamp_ns - view.stamp_ns - 2 * rest_ns, 1)
        for stamp_ns in range(view.stamp_ns - rest_ns, end, SETTINGS.tf_step_ns):
            share = float(np.clip((stamp_ns - view.stamp_ns - rest_ns) / moving_ns, 0, 1))
            T = geometry.interpolate_pose(view.T_world_camera, following.T_world_camera, share)
            transforms.append(Transform(stamp_ns + SETTINGS.latency_ns, world_frame, FRAME, T))
    return transforms


def _write_truth(bag: Path, scene: Scene, seed: int, more: dict) -> None:
    """Writes `truth.json`: the scene's truth, the recording's seed, and further entries."""
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
