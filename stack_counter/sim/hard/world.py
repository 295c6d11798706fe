# SPDX-License-Identifier: Apache-2.0
"""Worlds of any meshes, and noisy depth views of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from stack_counter.lean_open3d import o3c, o3d
from stack_counter.sim.camera.depth_camera import DepthCamera, perturb_pose
from stack_counter.sim.camera.recording import CAMERA, FRAME
from stack_counter.sim.camera.render import camera_rays
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import Intrinsics, Mesh, View


@dataclass(frozen=True)
class WorldSettings:
    """How worlds are seen; chosen.

    Attributes:
        floor_side_m, floor_thickness_m: size of the floor that everything stands on.
        step_ns: time between two views.
    """

    floor_side_m: float = 4.0
    floor_thickness_m: float = 0.01
    step_ns: int = 10**9


SETTINGS = WorldSettings()


def solid(body: trimesh.Trimesh) -> Mesh:
    """A body of trimesh as a mesh in the world."""
    return Mesh(np.asarray(body.vertices, np.float32), np.asarray(body.faces, np.int32))


def block(low: Sequence[float], high: Sequence[float]) -> Mesh:
    """An upright block between two corners, world, metres."""
    return solid(trimesh.creation.box(bounds=np.array([low, high], float)))


def floor() -> Mesh:
    """The floor at z = 0."""
    half = SETTINGS.floor_side_m / 2
    return block((-half, -half, -SETTINGS.floor_thickness_m), (half, half, 0))


def scene_meshes(scene: Scene) -> list[Mesh]:
    """The meshes of a scene's parts and of its container, if there is one."""
    container = scene.container.mesh()
    return [mesh for mesh in (scene.parts_mesh(), container) if mesh is not None]


def record_world(meshes: Sequence[Mesh], poses: Sequence[np.ndarray],
                 random: np.random.Generator, intrinsics: Intrinsics = CAMERA,
                 foreground: Sequence[Sequence[Mesh]] = ()) -> list[View]:
    """Records a world from true poses, with noise of depth and of the reported poses.

    Args:
        meshes: all that stands in the world.
        poses: (4, 4) true `T_world_camera` of each view.
        random: draws the noise.
        intrinsics: of the camera.
        foreground: further meshes in the world for each view alone; empty: none.
    """
    caster, sensor, views = _raycasting_scene(meshes), DepthCamera(), []
    for i, T in enumerate(poses):
        depth = _cast_depth(caster, intrinsics, T)
        if foreground and foreground[i]:
            before = _cast_depth(_raycasting_scene(foreground[i]), intrinsics, T)
            depth = np.minimum(depth, before)
        depth = np.where(np.isfinite(depth), depth, 0)
        views.append(View((i + 1) * SETTINGS.step_ns, intrinsics, perturb_pose(T, random),
                          depth=sensor.measure(depth, intrinsics, random), camera=FRAME))
    return views


def _raycasting_scene(meshes: Sequence[Mesh]) -> o3d.t.geometry.RaycastingScene:
    caster = o3d.t.geometry.RaycastingScene()
    for mesh in meshes:
        if len(mesh.triangles):
            caster.add_triangles(o3c.Tensor(mesh.vertices),
                                 o3c.Tensor(mesh.triangles.astype(np.uint32)))
    return caster


def _cast_depth(caster: o3d.t.geometry.RaycastingScene, intrinsics: Intrinsics, T: np.ndarray
                ) -> np.ndarray:
    """(h, w) float32 metres along optical z; infinite where nothing is hit."""
    rays = camera_rays(intrinsics, T).astype(np.float32)
    return caster.cast_rays(o3c.Tensor(rays))["t_hit"].numpy()


