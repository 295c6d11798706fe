"""Recordings as a robot arm makes them: an arc of views over the bin, noisy depth and poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stack_counter import geometry
from stack_counter.sim.camera.depth_camera import DepthCamera, perturb_pose
from stack_counter.sim.camera.render import Renderer
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import Intrinsics, View

CAMERA = Intrinsics(640, 480, 610.0, 610.0, 319.5, 239.5)
FRAME = "camera_color_optical_frame"
_NEAREST = 0.45  # m, from what is looked at
_MARGIN = 1.35  # of the view, around the bin
_STATION_TILT = np.deg2rad(32)
_TRIGGER_NS = 2_000_000  # by which the cameras of a station are triggered one after the other
_STEP_NS = 10**9  # between two views


def record(scene: Scene, views: int = 12, seed: int = 0, color: bool = True,
           camera: DepthCamera | None = None, pose_sigma_m: float = 0.0005,
           pose_sigma_deg: float = 0.05, intrinsics: Intrinsics = CAMERA, labels: bool = False
           ) -> list[View]:
    """Views of a scene; their poses are the reported ones, their pixels those of the true ones.

    Args:
        views: how many.
        seed: of the arc, the noise and the materials.
        color: render colour too (seconds a view).
        camera: noise model of the depth.
        pose_sigma_m, pose_sigma_deg: noise of the reported poses, per axis.
        intrinsics: with about the vertical field of view of `CAMERA`, for which the arc is laid.
        labels: give the true label images too.
    """
    random = np.random.default_rng([seed, scene.index, 0xA7])
    renderer, sensor = Renderer(scene), camera or DepthCamera()
    taken = [_view(renderer, T, perturb_pose(T, random, pose_sigma_m, pose_sigma_deg),
                   (i + 1) * _STEP_NS, sensor, random, seed if color else None, intrinsics)
             for i, T in enumerate(arc_poses(scene, views, random))]
    return taken if labels else [replace(view, labels=None) for view in taken]


def record_fixed_camera(states: list[Scene], seed: int = 0, color: bool = True) -> list[View]:
    """Views of one fixed camera above, one of each state of a scene; its pose is calibrated once.

    Args:
        states: of the same scene, e.g. with fewer and fewer parts.
        seed, color: as for `record`.
    """
    random = np.random.default_rng([seed, states[0].index, 0xF1])
    T, sensor = arc_poses(states[0], 1, random)[0], DepthCamera()
    reported = perturb_pose(T, random)
    return [replace(_view(Renderer(state), T, reported, (i + 1) * _STEP_NS, sensor, random,
                          seed if color else None), labels=None, fixed=True)
            for i, state in enumerate(states)]


def record_station(states: list[Scene], cameras: int = 4, seed: int = 0, color: bool = True
            ) -> dict[str, list[View]]:
    """Views of fixed cameras around the bin, each one of every state of a scene at the same time.

    Args:
        states: of the same scene, e.g. with other fills.
        cameras: how many; `left`, `front`, `right`, `back`, then numbers.
        seed, color: as for `record`.
    """
    random = np.random.default_rng([seed, states[0].index, 0x57A])
    names = [*("left", "front", "right", "back")[:cameras], *map(str, range(4, cameras))]
    points, sensor = states[0].parts_mesh().vertices.astype(float), DepthCamera()
    box = states[0].container.mesh()
    points = points if box is None else np.concatenate([points, box.vertices])
    low, high = points.min(axis=0), points.max(axis=0)
    target = np.array([*(low[:2] + high[:2]) / 2, high[2] / 2])
    radius = float(np.linalg.norm(high[:2] - low[:2])) / 2
    distance = max(_NEAREST, _MARGIN * radius * CAMERA.fy / (CAMERA.height / 2))
    poses = {}
    for i, name in enumerate(names):
        turn = np.pi + 2 * np.pi * i / cameras
        away = np.array([np.sin(_STATION_TILT) * np.cos(turn), np.sin(_STATION_TILT)
                         * np.sin(turn), np.cos(_STATION_TILT)])
        poses[name] = geometry.look_at(target + distance * away, target)
    reported = {name: perturb_pose(T, random) for name, T in poses.items()}
    out: dict[str, list[View]] = {name: [] for name in names}
    for k, state in enumerate(states):
        renderer = Renderer(state)
        for i, (name, T) in enumerate(poses.items()):
            stamp = (k + 1) * _STEP_NS + i * _TRIGGER_NS
            view = _view(renderer, T, reported[name], stamp, sensor, random,
                         seed if color else None)
            out[name].append(replace(view, labels=None, fixed=True,
                                     camera=f"{name}_optical_frame"))
    return out


def _view(renderer: Renderer, T: np.ndarray, reported: np.ndarray, stamp_ns: int,
          sensor: DepthCamera, random: np.random.Generator, materials: int | None,
          intrinsics: Intrinsics = CAMERA) -> View:
    depth, labels = renderer.render_depth_and_labels(intrinsics, T)
    return View(
        stamp_ns=stamp_ns, intrinsics=intrinsics, T_world_camera=reported, camera=FRAME,
        depth=sensor.measure(depth, intrinsics, random), labels=labels,
        color=None if materials is None else renderer.render_color(intrinsics, T, materials))


def arc_poses(scene: Scene, views: int, random: np.random.Generator) -> list[np.ndarray]:
    """True camera poses: once around the bin, tilted 10 to 45 degrees from the vertical."""
    points = scene.parts_mesh().vertices.astype(float)
    box = scene.container.mesh()
    points = points if box is None else np.concatenate([points, box.vertices])
    low, high = points.min(axis=0), points.max(axis=0)
    radius = float(np.linalg.norm(high[:2] - low[:2])) / 2
    target = np.array([*(low[:2] + high[:2]) / 2, high[2] / 2])
    distance = max(_NEAREST, _MARGIN * radius * CAMERA.fy / (CAMERA.height / 2))
    begin = random.uniform(0, 2 * np.pi)
    poses = []
    for i in range(views):
        turn = begin + 2 * np.pi * i / views
        tilt = np.deg2rad((12, 28, 42)[i % 3] + random.uniform(-3, 3))
        away = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        eye = target + (distance * random.uniform(1, 1.15)) * away
        poses.append(geometry.look_at(eye, target + random.normal(0, 0.01, 3)))
    return poses
