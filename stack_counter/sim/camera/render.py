# SPDX-License-Identifier: Apache-2.0
"""Ideal depth, labels and shaded colour of a scene by ray casting.

Pixel centres lie on whole numbers, z is optical.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.lean_open3d import o3c, o3d
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, Intrinsics, Mesh

Rgb = tuple[float, float, float]  # linear, 0 to 1


@dataclass(frozen=True)
class ShadingSettings:
    """How colour images are shaded; all chosen.

    Attributes:
        ground_half_side_m: half side of the support plane.
        sky_rays, shadow_rays: rays from a point for ambient occlusion and for the soft shadow.
        sky_reach_m: distance within which a surface takes ambient light away.
        light_spread, light_height_m: the light lies over the origin, up to so far along x and y.
        light_sigma_m: standard deviation of the area light.
        ambient, diffuse, highlight: weights of the three kinds of light.
        highlight_exponent: of the Blinn-Phong highlight.
        surface_offset_m: distance of a ray's origin from the surface that it leaves.
        part_tint_std: standard deviation of the parts' relative brightness.
        part_gloss: range of the parts' gloss.
        gloss: gloss of container and support plane.
        background: linear grey where nothing is hit.
        gamma: exponent of the display's response.
        speckle_m: side of the speckles of the support plane.
        container_colors, part_colors: linear RGB to draw from.
        wood: linear RGB of the support plane.
    """

    ground_half_side_m: float = 2.0
    sky_rays: int = 8
    shadow_rays: int = 4
    sky_reach_m: float = 0.15
    light_spread: float = 0.7
    light_height_m: float = 1.5
    light_sigma_m: float = 0.08
    ambient: float = 0.45
    diffuse: float = 0.75
    highlight: float = 0.5
    highlight_exponent: int = 30
    surface_offset_m: float = 2e-4
    part_tint_std: float = 0.08
    part_gloss: tuple[float, float] = (0.1, 0.9)
    gloss: float = 0.1
    background: float = 0.05
    gamma: float = 2.2
    speckle_m: float = 0.004
    container_colors: tuple[Rgb, ...] = (
        (0.16, 0.30, 0.62), (0.55, 0.56, 0.58), (0.62, 0.20, 0.16), (0.2, 0.2, 0.22))
    part_colors: tuple[Rgb, ...] = (
        (0.72, 0.73, 0.75), (0.78, 0.62, 0.30), (0.75, 0.75, 0.70), (0.25, 0.55, 0.35),
        (0.80, 0.45, 0.20), (0.35, 0.37, 0.40))
    wood: Rgb = (0.50, 0.38, 0.26)


SETTINGS = ShadingSettings()


class Renderer:
    """One scene, ready to be rendered from any pose."""

    def __init__(self, scene: Scene):
        """Builds the scene's ray-casting structure."""
        self._scene = scene
        self._faces_per_part = len(scene.shape.faces)
        parts, container = scene.parts_mesh(), scene.container.mesh()
        self._raycasting = o3d.t.geometry.RaycastingScene()
        self._labels = np.full(4, BACKGROUND, np.uint8)  # by geometry id
        self._add_mesh(_support_plane(), BACKGROUND)
        if container is not None:
            self._add_mesh(container, CONTAINER)
        self._add_mesh(parts, PARTS)

    def _add_mesh(self, mesh: Mesh, label: int) -> None:
        if len(mesh.triangles):
            geometry_id = self._raycasting.add_triangles(
                o3c.Tensor(mesh.vertices), o3c.Tensor(mesh.triangles.astype(np.uint32)))
            self._labels[geometry_id] = label

    def render_depth_and_labels(self, intrinsics: Intrinsics, T_world_camera: np.ndarray
                                ) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) float32 metres along optical z, 0 where nothing is hit; (h, w) uint8 labels."""
        hits = self._cast_rays(camera_rays(intrinsics, T_world_camera))
        depth = hits["t_hit"].numpy()
        hit = np.isfinite(depth)
        ids = np.where(hit, hits["geometry_ids"].numpy(), 0)
        labels = np.where(hit, self._labels[np.minimum(ids, 3)], BACKGROUND)
        return np.where(hit, depth, 0).astype(np.float32), labels.astype(np.uint8)

    def render_part_numbers(self, intrinsics: Intrinsics, T_world_camera: np.ndarray
                            ) -> np.ndarray:
        """(h, w) int32 number of the part that each pixel shows; -1 where none is."""
        hits = self._cast_rays(camera_rays(intrinsics, T_world_camera))
        ids = np.where(np.isfinite(hits["t_hit"].numpy()), hits["geometry_ids"].numpy(), 0)
        part = hits["primitive_ids"].numpy().astype(np.int64) // self._faces_per_part
        return np.where(self._labels[np.minimum(ids, 3)] == PARTS, part, -1).astype(np.int32)

    def render_color(self, intrinsics: Intrinsics, T_world_camera: np.ndarray, seed: int
                     ) -> np.ndarray:
        """(h, w, 3) uint8 RGB: Lambert and a highlight, soft shadow, ambient occlusion.

        `seed` draws the materials and the light; one for all views of a recording.
        """
        random = np.random.default_rng([seed, 0xC0])
        # Surface points, their normals towards the camera
        rays = camera_rays(intrinsics, T_world_camera)
        hits = self._cast_rays(rays)
        depth = hits["t_hit"].numpy()
        hit = np.isfinite(depth)
        eye, direction = rays[..., :3], rays[..., 3:]
        points = eye + direction * np.where(hit, depth, 1)[..., None]
        to_eye = -_unit(direction)
        normal = hits["primitive_normals"].numpy()
        normal = np.where(np.sum(normal * to_eye, -1, keepdims=True) < 0, -normal, normal)
        # Materials and one area light
        albedo, gloss = self._draw_materials(hits, points, random)
        spread = SETTINGS.light_spread
        light = np.array([*random.uniform(-spread, spread, 2), SETTINGS.light_height_m])
        # Shadow and ambient occlusion by sampling
        start = points + SETTINGS.surface_offset_m * normal
        noise = np.random.default_rng(seed + 1)
        lit = self._visible_light(start, light, noise)
        open_sky = self._visible_sky(start, normal, noise)
        # Shading: ambient, Lambert, Blinn-Phong
        to_light = _unit(light - points)
        facing = np.clip(np.sum(normal * to_light, -1), 0, 1)
        halfway = _unit(to_light + to_eye)
        shine = np.clip(np.sum(normal * halfway, -1), 0, 1) ** SETTINGS.highlight_exponent \
            * gloss * lit
        shade = SETTINGS.ambient * open_sky + SETTINGS.diffuse * facing * lit
        image = albedo * shade[..., None] + SETTINGS.highlight * shine[..., None]
        image = np.where(hit[..., None], image, SETTINGS.background)
        return (255 * np.clip(image, 0, 1) ** (1 / SETTINGS.gamma)).astype(np.uint8)

    def _cast_rays(self, rays: np.ndarray) -> dict[str, o3c.Tensor]:
        return self._raycasting.cast_rays(
            o3c.Tensor(np.ascontiguousarray(rays, np.float32)))

    def _draw_materials(self, hits: dict[str, o3c.Tensor], points: np.ndarray,
                        random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Albedo (h, w, 3) and gloss (h, w) of what the rays hit."""
        ids = hits["geometry_ids"].numpy()
        label = self._labels[np.where(ids < 4, ids, 0)]
        # The container has one colour; parts differ a little in brightness
        container = np.array(_draw_color(random, SETTINGS.container_colors))
        base = np.array(_draw_color(random, SETTINGS.part_colors))
        tints = 1 + random.normal(0, SETTINGS.part_tint_std, (len(self._scene.poses) + 1, 1))
        part = np.minimum(hits["primitive_ids"].numpy() // self._faces_per_part, len(tints) - 1)
        albedo = np.where((label == PARTS)[..., None], base * tints[part], _wood_texture(points))
        albedo = np.where((label == CONTAINER)[..., None], container, albedo)
        gloss = np.where(label == PARTS, random.uniform(*SETTINGS.part_gloss), SETTINGS.gloss)
        return albedo, gloss

    def _visible_light(self, start: np.ndarray, light: np.ndarray, noise: np.random.Generator
                       ) -> np.ndarray:
        """(h, w) share of an area light that is visible from a point."""
        total = np.zeros(start.shape[:2])
        for _ in range(SETTINGS.shadow_rays):
            to_light = light + noise.normal(0, SETTINGS.light_sigma_m,
                                            (*start.shape[:2], 3)) - start
            total += self._unoccluded(start, to_light)
        return total / SETTINGS.shadow_rays

    def _visible_sky(self, start: np.ndarray, normal: np.ndarray, noise: np.random.Generator
                     ) -> np.ndarray:
        """(h, w) share of the cosine-weighted hemisphere that is free over the sky's reach."""
        total = np.zeros(start.shape[:2])
        for _ in range(SETTINGS.sky_rays):
            on_sphere = _unit(noise.normal(size=(*start.shape[:2], 3)))
            way = SETTINGS.sky_reach_m * (normal * 1.001 + on_sphere)  # never of length 0
            total += self._unoccluded(start, way)
        return total / SETTINGS.sky_rays

    def _unoccluded(self, start: np.ndarray, way: np.ndarray) -> np.ndarray:
        """(h, w) bool: nothing lies between the points (h, w, 3) and their ways' ends."""
        rays = np.concatenate([start, way], axis=-1).astype(np.float32)
        return ~self._raycasting.test_occlusions(o3c.Tensor(rays), tnear=1e-3, tfar=1.0).numpy()


def camera_rays(intrinsics: Intrinsics, T_world_camera: np.ndarray) -> np.ndarray:
    """(h, w, 6) float64 origins and directions in the world.

    Direction length 1 along optical z, so that a hit's parameter is its depth.
    """
    directions = geometry.pixel_rays(intrinsics, dtype=np.float64) @ T_world_camera[:3, :3].T
    origins = np.broadcast_to(T_world_camera[:3, 3], directions.shape)
    return np.concatenate([origins, directions], axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) vectors of length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _draw_color(random: np.random.Generator, colors: tuple[Rgb, ...]) -> Rgb:
    return colors[random.integers(len(colors))]


def _wood_texture(points: np.ndarray) -> np.ndarray:
    """(h, w, 3) albedo of the support plane at points (h, w, 3), world, metres.

    Speckled, so that it has texture from every distance.
    """
    cells = np.floor(points[..., :2] / SETTINGS.speckle_m).astype(np.int64)
    speckle = ((cells[..., 0] * 73856093 ^ cells[..., 1] * 19349663) % 997) / 997
    grain = 0.5 + 0.5 * np.sin(points[..., 0] * 60 + 3 * np.sin(points[..., 1] * 13))
    return np.array(SETTINGS.wood) * (0.7 + 0.2 * speckle + 0.2 * grain)[..., None]


def _support_plane() -> Mesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) \
        * SETTINGS.ground_half_side_m
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
