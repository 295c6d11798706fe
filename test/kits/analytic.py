# SPDX-License-Identifier: Apache-2.0
"""Depth views of boxes, upright cylinders, spheres and the plane z = 0 in closed form."""

from __future__ import annotations

from itertools import product

import numpy as np
import open3d as o3d

from stack_counter import geometry
from stack_counter.types import Intrinsics, Mesh, View

CAMERA = Intrinsics(640, 480, 610.0, 610.0, 319.5, 239.5)
_CUBE = np.array(list(product((-1.0, 1.0), repeat=3)))


class Scene:
    """Convex solids on the plane z = 0; boxes may be turned about z."""

    def __init__(self, plane=True):
        """An empty scene, with the plane or without.

        Every solid has (n, 3) corners that enclose it, None for the plane, and a function of (3,)
        an origin and (h, w, 3) directions that gives the (h, w) lengths of the rays up to it,
        infinite where they miss it.
        """
        self._solids = [(None, _plane_distance)] if plane else []

    def box(self, center, size, yaw=0.0):
        """Adds a box: centre and size in metres, yaw in radians."""
        c, s = np.cos(yaw), np.sin(yaw)
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        half = np.array(size) / 2
        self._solids.append((center + _CUBE * half @ rotation.T, lambda o, d: _box_distance(
            (o - center) @ rotation, d @ rotation, half)))
        return self

    def cylinder(self, x, y, radius, height):
        """Adds an upright cylinder that stands on z = 0."""
        half = np.array([radius, radius, height / 2])
        self._solids.append(([x, y, height / 2] + _CUBE * half, lambda o, d: _cylinder_distance(
            o - [x, y, 0], d, radius, height)))
        return self

    def sphere(self, center, radius):
        """Adds a ball."""
        self._solids.append((center + _CUBE * radius, lambda o, d: _sphere_distance(
            o - np.array(center), d, radius)))
        return self

    def mesh(self, mesh):
        """Adds triangles (`types.Mesh`, world frame)."""
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))

        def distance(origin, directions):
            rays = np.concatenate([np.broadcast_to(origin, directions.shape), directions], -1)
            return scene.cast_rays(rays.astype(np.float32))["t_hit"].numpy().astype(float)
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        self._solids.append(((low + high) / 2 + _CUBE * (high - low) / 2, distance))
        return self

    def filled(self, container, level):
        """Adds a simulator's container filled flat up to `level` metres above its floor.

        Returns:
            Its volume between the floor and that level, m3.
        """
        rings = container.inner_rings
        # Integrate the area of the outlines over the height.
        zs = np.linspace(rings[0, 0, 2], rings[0, 0, 2] + level, 50)
        outlines = np.stack([_outline_at(rings, z) for z in zs])
        x, y = outlines[..., 0], outlines[..., 1]
        areas = np.sum(x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y, axis=1) / 2
        # Close the filling with a fan of triangles.
        top = np.concatenate([outlines[-1], outlines[-1].mean(axis=0)[None]])
        n = len(outlines[-1])
        fan = np.stack([np.arange(n), np.roll(np.arange(n), -1), np.full(n, n)], axis=1)
        self.mesh(container.mesh())
        if level:
            self.mesh(Mesh(geometry.apply(container.T_world_container, top), fan))
        return float(np.sum((areas[1:] + areas[:-1]) / 2 * np.diff(zs)))

    def bin(self, inner, wall, floor, fill, x=0.0, y=0.0, yaw=0.0):
        """Adds an upright open box filled flat to `fill` metres above its floor."""
        a, b, h = inner
        rim = floor + h
        c, s = np.cos(yaw), np.sin(yaw)

        def add(u, v, z, size):
            self.box([x + c * u - s * v, y + s * u + c * v, z], size, yaw)

        for side in (-1, 1):
            add(side * (a + wall) / 2, 0, rim / 2, [wall, b + 2 * wall, rim])
            add(0, side * (b + wall) / 2, rim / 2, [a + 2 * wall, wall, rim])
        add(0, 0, (floor + fill) / 2, [a + wall, b + wall, floor + fill])
        return self

    def view(self, T_world_camera, camera=CAMERA, stamp_ns=0, noise=0.0, seed=0):
        """Depth view; `noise` is the standard deviation in metres."""
        rays = geometry.pixel_rays(camera, dtype=np.float64)
        directions = rays @ T_world_camera[:3, :3].T
        nearest = np.full(directions.shape[:2], np.inf)
        for corners, distance in self._solids:
            window = _window(corners, T_world_camera, camera)
            if nearest[window].size:
                nearest[window] = np.minimum(nearest[window], distance(
                    T_world_camera[:3, 3], directions[window]))
        depth = np.where(np.isfinite(nearest), nearest, 0)
        if noise:
            depth = depth + np.random.default_rng(seed).normal(0, noise, depth.shape)
        return View(stamp_ns, camera, T_world_camera, depth=depth.astype(np.float32))

    def views(self, count=12, radius=0.6, center=(0, 0, 0.05), tilts=(20, 40), **view_options):
        """Views from a ring of poses that look at the centre; tilts in degrees from vertical."""
        views = []
        for i in range(count):
            azimuth, tilt = 2 * np.pi * i / count, np.deg2rad(tilts[i % len(tilts)])
            eye = np.array(center) + radius * np.array(
                [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
            T = geometry.look_at(eye, np.array(center, float))
            views.append(self.view(T, stamp_ns=i * 10**9, seed=i, **view_options))
        return views


def _window(corners, T_world_camera, camera):
    """Slices of the rows and columns of an image that all rays lie in which may meet a solid."""
    everywhere = slice(None), slice(None)
    if corners is None:
        return everywhere
    pixels, z = geometry.project(
        geometry.apply(geometry.inverse(T_world_camera), corners), camera)
    if z.min() <= 0:
        return everywhere
    size = camera.width, camera.height
    left, top = np.clip(np.floor(pixels.min(axis=0)), 0, size).astype(int)
    right, bottom = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, size).astype(int)
    return slice(top, bottom), slice(left, right)


def _outline_at(rings, z):
    """(n, 3) outline of a container at a height."""
    i = int(np.clip(np.searchsorted(rings[:, 0, 2], z), 1, len(rings) - 1))
    low, high = rings[i - 1, 0, 2], rings[i, 0, 2]
    return rings[i - 1] + (rings[i] - rings[i - 1]) * (z - low) / (high - low)


def _plane_distance(origin, directions):
    with np.errstate(divide="ignore"):
        t = -origin[2] / directions[..., 2]
    return np.where(t > 0, t, np.inf)


def _box_distance(origin, directions, half):
    near, far = np.zeros(directions.shape[:-1]), np.full(directions.shape[:-1], np.inf)
    for o, d, h in zip(origin, np.ascontiguousarray(np.moveaxis(directions, -1, 0)), half):
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (-h - o) / d, (h - o) / d
        near, far = np.fmax(near, np.minimum(a, b)), np.fmin(far, np.maximum(a, b))
    return np.where((near <= far) & (near > 0), near, np.inf)


def _cylinder_distance(origin, directions, radius, height):
    a = directions[..., 0]**2 + directions[..., 1]**2
    b = directions[..., 0] * origin[0] + directions[..., 1] * origin[1]
    c = origin[0]**2 + origin[1]**2 - radius**2
    with np.errstate(divide="ignore", invalid="ignore"):
        side = (-b - np.sqrt(b**2 - a * c)) / a
        z = origin[2] + side * directions[..., 2]
        side = np.where((side > 0) & (z >= 0) & (z <= height), side, np.inf)
        top = (height - origin[2]) / directions[..., 2]
        reach = (origin[0] + top * directions[..., 0])**2 + (origin[1] + top
                                                             * directions[..., 1])**2
        top = np.where((top > 0) & (reach <= radius**2), top, np.inf)
    return np.fmin(side, top)


def _sphere_distance(origin, directions, radius):
    a = np.sum(directions**2, axis=-1)
    b = directions @ origin
    with np.errstate(invalid="ignore"):
        t = (-b - np.sqrt(b**2 - a * (origin @ origin - radius**2))) / a
    return np.where(np.isfinite(t) & (t > 0), t, np.inf)
