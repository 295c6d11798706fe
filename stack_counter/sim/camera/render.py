"""Ideal depth, labels and shaded colour of a scene by ray casting.

Rays are built from K and T here: pixel centres lie on whole numbers, z is optical.
"""

from __future__ import annotations

import numpy as np
import open3d as o3d
import open3d.core as o3c

from stack_counter import geometry
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, Intrinsics, Mesh

_PLANE = 2.0  # half side of the support plane, m
_OCCLUSION_RAYS, _SHADOW_RAYS = 8, 4
_CONTAINER_COLORS = ((0.16, 0.30, 0.62), (0.55, 0.56, 0.58), (0.62, 0.20, 0.16), (0.2, 0.2, 0.22))
_PART_COLORS = ((0.72, 0.73, 0.75), (0.78, 0.62, 0.30), (0.75, 0.75, 0.70), (0.25, 0.55, 0.35),
                (0.80, 0.45, 0.20), (0.35, 0.37, 0.40))


class Renderer:
    """One scene, ready to be looked at from anywhere."""

    def __init__(self, scene: Scene):
        self._scene = scene
        self._faces = len(scene.shape.faces)
        parts, box = scene.parts_mesh(), scene.container.mesh()
        self._rays = o3d.t.geometry.RaycastingScene()
        self._labels = np.full(4, BACKGROUND, np.uint8)  # by geometry id
        self._add(_plane(), BACKGROUND)
        if box is not None:
            self._add(box, CONTAINER)
        self._add(parts, PARTS)

    def _add(self, mesh: Mesh, label: int) -> None:
        if len(mesh.triangles):
            name = self._rays.add_triangles(o3c.Tensor(mesh.vertices),
                                            o3c.Tensor(mesh.triangles.astype(np.uint32)))
            self._labels[name] = label

    def render_depth_and_labels(self, k: Intrinsics, T_world_camera: np.ndarray
                         ) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) float32 metres along optical z, 0 where nothing is hit; (h, w) uint8 labels."""
        hits = self._cast(camera_rays(k, T_world_camera))
        depth = hits["t_hit"].numpy()
        seen = np.isfinite(depth)
        ids = np.where(seen, hits["geometry_ids"].numpy(), 0)
        labels = np.where(seen, self._labels[np.minimum(ids, 3)], BACKGROUND)
        return np.where(seen, depth, 0).astype(np.float32), labels.astype(np.uint8)

    def render_color(self, k: Intrinsics, T_world_camera: np.ndarray, seed: int) -> np.ndarray:
        """(h, w, 3) uint8 RGB: Lambert and a highlight, soft shadow, ambient occlusion.

        `seed` draws the materials and the light; one for all views of a recording.
        """
        random = np.random.default_rng([seed, 0xC0])
        rays = camera_rays(k, T_world_camera)
        hits = self._cast(rays)
        t = hits["t_hit"].numpy()
        seen = np.isfinite(t)
        eye, direction = rays[..., :3], rays[..., 3:]
        points = eye + direction * np.where(seen, t, 1)[..., None]
        normal = hits["primitive_normals"].numpy()
        view = -direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        normal = np.where(np.sum(normal * view, -1, keepdims=True) < 0, -normal, normal)
        albedo, gloss = self._materials(hits, points, random)
        light = np.array([*random.uniform(-0.7, 0.7, 2), 1.5])
        start = points + 2e-4 * normal
        noise = np.random.default_rng(seed + 1)
        shadow = self._visible(start, normal, light, noise)
        ambient = self._open_sky(start, normal, noise)
        to_light = light - points
        to_light /= np.linalg.norm(to_light, axis=-1, keepdims=True)
        facing = np.clip(np.sum(normal * to_light, -1), 0, 1)
        half = to_light + view
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        shine = np.clip(np.sum(normal * half, -1), 0, 1) ** 30 * gloss * shadow
        shade = 0.45 * ambient + 0.75 * facing * shadow
        image = albedo * shade[..., None] + 0.5 * shine[..., None]
        image = np.where(seen[..., None], image, 0.05)
        return (255 * np.clip(image, 0, 1) ** (1 / 2.2)).astype(np.uint8)

    def _cast(self, rays: np.ndarray) -> dict[str, o3c.Tensor]:
        return self._rays.cast_rays(o3c.Tensor(np.ascontiguousarray(rays, np.float32)))

    def _materials(self, hits: dict[str, o3c.Tensor], points: np.ndarray,
                   random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Albedo (h, w, 3) and gloss (h, w)."""
        ids = hits["geometry_ids"].numpy()
        label = self._labels[np.where(ids < 4, ids, 0)]
        # The support plane is speckled, so that it has texture from every distance.
        cells = np.floor(points[..., :2] / 0.004).astype(np.int64)
        speckle = ((cells[..., 0] * 73856093 ^ cells[..., 1] * 19349663) % 997) / 997
        grain = 0.5 + 0.5 * np.sin(points[..., 0] * 60 + 3 * np.sin(points[..., 1] * 13))
        wood = np.array([0.50, 0.38, 0.26]) * (0.7 + 0.2 * speckle + 0.2 * grain)[..., None]
        box = np.array(_CONTAINER_COLORS[random.integers(len(_CONTAINER_COLORS))])
        base = np.array(_PART_COLORS[random.integers(len(_PART_COLORS))])
        tints = 1 + random.normal(0, 0.08, (len(self._scene.poses) + 1, 1))
        part = np.minimum(hits["primitive_ids"].numpy() // self._faces, len(tints) - 1)
        albedo = np.where((label == PARTS)[..., None], base * tints[part], wood)
        albedo = np.where((label == CONTAINER)[..., None], box, albedo)
        return albedo, np.where(label == PARTS, random.uniform(0.1, 0.9), 0.1)

    def _visible(self, start: np.ndarray, normal: np.ndarray, light: np.ndarray,
                 noise: np.random.Generator) -> np.ndarray:
        """(h, w) share of an area light that a point sees."""
        total = np.zeros(start.shape[:2])
        for _ in range(_SHADOW_RAYS):
            to_light = light + noise.normal(0, 0.08, (*start.shape[:2], 3)) - start
            total += self._free(start, to_light, 1.0)
        return total / _SHADOW_RAYS

    def _open_sky(self, start: np.ndarray, normal: np.ndarray, noise: np.random.Generator
                  ) -> np.ndarray:
        """(h, w) share of the cosine-weighted hemisphere that is free for 15 cm."""
        total = np.zeros(start.shape[:2])
        for _ in range(_OCCLUSION_RAYS):
            ball = noise.normal(size=(*start.shape[:2], 3))
            ball /= np.linalg.norm(ball, axis=-1, keepdims=True)
            total += self._free(start, 0.15 * (normal * 1.001 + ball), 1.0)
        return total / _OCCLUSION_RAYS

    def _free(self, start: np.ndarray, way: np.ndarray, far: float) -> np.ndarray:
        rays = np.concatenate([start, way], axis=-1).astype(np.float32)
        return ~self._rays.test_occlusions(o3c.Tensor(rays), tnear=1e-3, tfar=far).numpy()


def camera_rays(k: Intrinsics, T_world_camera: np.ndarray) -> np.ndarray:
    """(h, w, 6) float64 origins and directions in the world; direction length 1 along optical z,
    so that a hit's parameter is its depth."""
    directions = geometry.pixel_rays(k, dtype=np.float64) @ T_world_camera[:3, :3].T
    origins = np.broadcast_to(T_world_camera[:3, 3], directions.shape)
    return np.concatenate([origins, directions], axis=-1)


def _plane() -> Mesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * _PLANE
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
