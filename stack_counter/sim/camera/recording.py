# SPDX-License-Identifier: Apache-2.0
"""Recordings as a robot arm makes them: an arc of views over the bin, noisy depth and poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stack_counter import geometry
from stack_counter.sim.camera.depth_camera import DepthCamera, perturb_pose
from stack_counter.sim.camera.render import Renderer
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import Intrinsics, View

CAMERA = Intrinsics(640, 480, 610.0, 610.0, 319.5, 239.5)
FRAME = "camera_color_optical_frame"


@dataclass(frozen=True)
class RecordingSettings:
    """Where the cameras stand, and when they are exposed; all chosen.

    Attributes:
        min_distance_m: least distance of a camera from its target.
        margin: by how much the view is wider than the bin.
        arc_tilts_deg: tilts of an arm's views from the vertical, taken in turn.
        tilt_play_deg: largest deviation from them.
        max_distance: largest factor by which an arm's view is farther away than need be.
        target_sigma_m: standard deviation of the point that an arm's camera is aimed at, per axis.
        station_tilt_deg: tilt of a station's cameras from the vertical.
        step_ns: time between two views.
        trigger_ns: time between a station's cameras, which are triggered one after the other.
    """

    min_distance_m: float = 0.45
    margin: float = 1.35
    arc_tilts_deg: tuple[float, ...] = (12, 28, 42)
    tilt_play_deg: float = 3
    max_distance: float = 1.15
    target_sigma_m: float = 0.01
    station_tilt_deg: float = 32
    step_ns: int = 10**9
    trigger_ns: int = 2_000_000


SETTINGS = RecordingSettings()


def record(scene: Scene, views: int = 12, seed: int = 0, color: bool = True,
           camera: DepthCamera | None = None, pose_sigma_m: float = 0.0005,
           pose_sigma_deg: float = 0.05, intrinsics: Intrinsics = CAMERA, labels: bool = False
           ) -> list[View]:
    """Records a scene from an arc of views, with noisy depth and poses.

    The poses of the views are the reported ones, their pixels those of the true ones.

    Args:
        scene: what is recorded.
        views: number of views.
        seed: seed of the arc, the noise and the materials.
        color: render colour too (seconds a view).
        camera: noise model of the depth.
        pose_sigma_m: noise of the reported positions, per axis, metres.
        pose_sigma_deg: noise of the reported rotations, per axis, degrees.
        intrinsics: with about the vertical field of view of `CAMERA`, for which the arc is laid.
        labels: give the true label images too.
    """
    random = np.random.default_rng([seed, scene.index, 0xA7])
    renderer, sensor = Renderer(scene), camera or DepthCamera()
    materials = seed if color else None
    recorded = [_render_view(renderer, T, perturb_pose(T, random, pose_sigma_m, pose_sigma_deg),
                             (i + 1) * SETTINGS.step_ns, sensor, random, materials, intrinsics)
                for i, T in enumerate(arc_poses(*scene.bounds(), views, random))]
    return recorded if labels else [replace(view, labels=None) for view in recorded]


def scaled_camera(width_px: int) -> Intrinsics:
    """`CAMERA` with pictures of another width, which show the same."""
    scale = width_px / CAMERA.width
    return Intrinsics(width_px, round(CAMERA.height * scale), CAMERA.fx * scale,
                      CAMERA.fy * scale, (CAMERA.cx + 0.5) * scale - 0.5,
                      (CAMERA.cy + 0.5) * scale - 0.5)


def record_fixed_camera(states: list[Scene], seed: int = 0, color: bool = True) -> list[View]:
    """Records a view of each state of a scene by one fixed camera above, calibrated once.

    Args:
        states: states of the same scene, e.g. with fewer and fewer parts.
        seed: seed of the pose, the noise and the materials.
        color: render colour too (seconds a view).
    """
    random = np.random.default_rng([seed, states[0].index, 0xF1])
    T, sensor = arc_poses(*states[0].bounds(), 1, random)[0], DepthCamera()
    reported = perturb_pose(T, random)
    materials = seed if color else None
    return [replace(_render_view(Renderer(state), T, reported, (i + 1) * SETTINGS.step_ns,
                                 sensor, random, materials), labels=None, fixed=True)
            for i, state in enumerate(states)]


def record_returning_camera(states: list[Scene], places: int = 2, seed: int = 0,
                            color: bool = True) -> list[View]:
    """Records a view of each state of a scene by an arm's camera that goes from place to place.

    It comes back to each place again and again; its reported pose is off by another error each
    time, as those of an arc of views are.

    Args:
        states: states of the same scene, e.g. with fewer and fewer parts.
        places: number of places, which take turns.
        seed: seed of the poses, the noise and the materials.
        color: render colour too (seconds a view).
    """
    random = np.random.default_rng([seed, states[0].index, 0xBC])
    poses, sensor = arc_poses(*states[0].bounds(), places, random), DepthCamera()
    materials = seed if color else None
    views = []
    for i, state in enumerate(states):
        T = poses[i % places]
        views.append(_render_view(Renderer(state), T, perturb_pose(T, random),
                                  (i + 1) * SETTINGS.step_ns, sensor, random, materials))
    return [replace(view, labels=None) for view in views]


def record_station(states: list[Scene], cameras: int = 4, seed: int = 0, color: bool = True
                   ) -> dict[str, list[View]]:
    """Records every state of a scene by fixed cameras around the bin, all at the same time.

    Args:
        states: states of the same scene, e.g. with other fills.
        cameras: number of cameras; `left`, `front`, `right`, `back`, then numbers.
        seed: seed of the noise and the materials.
        color: render colour too (seconds a view).

    Returns:
        The views of each camera, by its name.
    """
    random = np.random.default_rng([seed, states[0].index, 0x57A])
    names = [*("left", "front", "right", "back")[:cameras], *map(str, range(4, cameras))]
    # True poses around the bin, and as they were calibrated
    target, distance = _framing(*states[0].bounds())
    tilt = np.deg2rad(SETTINGS.station_tilt_deg)
    poses = {name: geometry.look_at(
        target + distance * _direction(tilt, np.pi + 2 * np.pi * i / cameras), target)
        for i, name in enumerate(names)}
    reported = {name: perturb_pose(T, random) for name, T in poses.items()}
    # One cycle for each state
    sensor, materials = DepthCamera(), seed if color else None
    recorded: dict[str, list[View]] = {name: [] for name in names}
    for k, state in enumerate(states):
        renderer = Renderer(state)
        for i, (name, T) in enumerate(poses.items()):
            stamp_ns = (k + 1) * SETTINGS.step_ns + i * SETTINGS.trigger_ns
            view = _render_view(renderer, T, reported[name], stamp_ns, sensor, random, materials)
            recorded[name].append(replace(view, labels=None, fixed=True,
                                          camera=f"{name}_optical_frame"))
    return recorded


def arc_poses(low: np.ndarray, high: np.ndarray, views: int, random: np.random.Generator
              ) -> list[np.ndarray]:
    """True camera poses: once around what stands between two corners, tilted 10 to 45 degrees.

    Args:
        low, high: (3,) corners, world, metres; `low` lies on the support plane.
        views: number of poses.
        random: draws where the arc starts, and how much each pose deviates from it.

    Returns:
        (4, 4) float64 `T_world_camera` of each view.
    """
    target, distance = _framing(low, high)
    start = random.uniform(0, 2 * np.pi)
    tilts, play = SETTINGS.arc_tilts_deg, SETTINGS.tilt_play_deg
    poses = []
    for i in range(views):
        tilt = np.deg2rad(tilts[i % len(tilts)] + random.uniform(-play, play))
        away = _direction(tilt, start + 2 * np.pi * i / views)
        eye = target + (distance * random.uniform(1, SETTINGS.max_distance)) * away
        aim = target + random.normal(0, SETTINGS.target_sigma_m, 3)
        poses.append(geometry.look_at(eye, aim))
    return poses


def _framing(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
    """Middle (3,) between two corners, and the distance from which `CAMERA` sees all of it."""
    radius = float(np.linalg.norm(high[:2] - low[:2])) / 2
    target = np.array([*(low[:2] + high[:2]) / 2, high[2] / 2])
    fitting = SETTINGS.margin * radius * CAMERA.fy / (CAMERA.height / 2)
    return target, max(SETTINGS.min_distance_m, fitting)


def _direction(tilt: float, azimuth: float) -> np.ndarray:
    """(3,) unit vector tilted from the vertical, radians."""
    return np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth),
                     np.cos(tilt)])


def _render_view(renderer: Renderer, T: np.ndarray, reported: np.ndarray, stamp_ns: int,
                 sensor: DepthCamera, random: np.random.Generator, materials: int | None,
                 intrinsics: Intrinsics = CAMERA) -> View:
    """One view from a true pose T with its reported pose.

    `materials` is the colour's seed, None for no colour.
    """
    depth, labels = renderer.render_depth_and_labels(intrinsics, T)
    return View(
        stamp_ns=stamp_ns, intrinsics=intrinsics, T_world_camera=reported, camera=FRAME,
        depth=sensor.measure(depth, intrinsics, random), labels=labels,
        color=None if materials is None else renderer.render_color(intrinsics, T, materials))
