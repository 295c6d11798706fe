# SPDX-License-Identifier: Apache-2.0
"""Piles of simulated scenes as pieces to build with: moved, turned, scaled, partly emptied."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.sim.scenes.scene import Scene, rotation_matrices
from stack_counter.sim.scenes.shards import read_scenes


@dataclass(frozen=True)
class PileSettings:
    """Which piles are built with; chosen: bins that are counted well where nothing is hard.

    Attributes:
        scenes: number of scenes that are read.
        fill: range of the stack's mean height over the bin's depth.
        least_depth_m: depth of the shallowest bin.
        least_parts: parts of the smallest pile.
        largest_side_m: inner side of the largest bin.
    """

    scenes: int = 400
    fill: tuple[float, float] = (0.3, 0.95)
    least_depth_m: float = 0.03
    least_parts: int = 20
    largest_side_m: float = 0.2


SETTINGS = PileSettings()


def read_piles(folder: Path) -> list[Scene]:
    """The piles in bins of a folder's first scenes.

    Raises:
        SceneError: no shard there, or a damaged one.
    """
    s = SETTINGS
    return [scene for scene in read_scenes(folder, s.scenes)
            if scene.container.kind == "bin" and s.fill[0] <= scene.truth.fill <= s.fill[1]
            and scene.container.inner_size_m[2] >= s.least_depth_m
            and len(scene.poses) >= s.least_parts
            and max(scene.container.inner_size_m[:2]) <= s.largest_side_m]


def outer_size(scene: Scene) -> np.ndarray:
    """(3,) metres: the bin's sides at the rim with its walls, and the height of its rim."""
    shape = scene.container
    return np.append(np.array(shape.inner_size_m[:2]) + 2 * shape.wall_thickness_m,
                     shape.rim_height_m)


def placed(scene: Scene, xyz: np.ndarray, yaw: float = 0.0) -> Scene:
    """The scene with its container's origin at a place (3,), metres, turned by `yaw`, rad."""
    c, s = np.cos(yaw), np.sin(yaw)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.asarray(xyz, float))
    return replace(scene, container=replace(scene.container, T_world_container=T))


def scaled(scene: Scene, factor: float) -> Scene:
    """The scene with every length multiplied."""
    shape = scene.container
    return replace(
        scene, shape=replace(scene.shape, vertices=scene.shape.vertices * factor),
        poses=scene.poses * np.append(np.full(3, factor), np.ones(4)), stored_truth=None,
        container=replace(shape, inner_size_m=tuple(factor * x for x in shape.inner_size_m),
                          wall_thickness_m=factor * shape.wall_thickness_m,
                          floor_thickness_m=factor * shape.floor_thickness_m))


def with_lowest_parts(scene: Scene, share: float) -> Scene:
    """The scene with that share of its parts, the lowest; 0 leaves an empty container."""
    order = np.argsort(scene.poses[:, 2], kind="stable")
    return replace(scene, poses=scene.poses[order[:round(share * len(order))]], stored_truth=None)


def parts_within(scene: Scene, low: np.ndarray, high: np.ndarray) -> int:
    """Number of parts whose middle lies between two corners (3,), world, metres."""
    middles = geometry.apply(scene.container.T_world_container, scene.poses[:, :3])
    return int(np.all((middles >= low) & (middles <= high), axis=1).sum())


def part_extents(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Of each part (n,), metres: its lowest point's height in the container's frame.

    And its reach: the horizontal distance from its middle to its farthest point.
    """
    turned = np.einsum("nij,vj->nvi", rotation_matrices(scene.poses), scene.shape.vertices)
    reach = np.linalg.norm(turned[..., :2], axis=-1).max(axis=1)
    return turned[..., 2].min(axis=1) + scene.poses[:, 2], reach
