# SPDX-License-Identifier: Apache-2.0
"""Hard because of the views: one short, two swapped, or a robot arm before the bin."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from stack_counter import geometry
from stack_counter.sim.camera.recording import arc_poses
from stack_counter.sim.hard.piles import outer_size, placed
from stack_counter.sim.hard.scan import HardScan
from stack_counter.sim.hard.world import floor, record_world, scene_meshes, solid
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import Mesh, View


@dataclass(frozen=True)
class ViewSettings:
    """How views go wrong; all chosen.

    Attributes:
        views: least and largest number of a scan's.
        short_m: range by which a view's depth is short or long.
        link_radius_m: range of the radius of an arm's links.
        base_m: range of an arm's distance from the bin.
        elbow_m: height of its elbow above the line from base to hand.
        hand_above_m: range of its hand's height above the rim.
        hand_length_m: length of its hand.
        clearance_m: least distance between a camera and an arm's surface.
        finger_size_m: sides of a gripper's fingers and palm.
        finger_from_camera_m: range of a gripper's distance from the camera that carries it.
    """

    views: tuple[int, int] = (3, 6)
    short_m: tuple[float, float] = (0.03, 0.1)
    link_radius_m: tuple[float, float] = (0.025, 0.05)
    base_m: tuple[float, float] = (0.45, 0.7)
    elbow_m: float = 0.45
    hand_above_m: tuple[float, float] = (0.03, 0.2)
    hand_length_m: float = 0.12
    clearance_m: float = 0.05
    finger_size_m: tuple[float, float, float] = (0.02, 0.02, 0.08)
    finger_from_camera_m: tuple[float, float] = (0.12, 0.25)


SETTINGS = ViewSettings()


def make_view_short(pile: Scene, random: np.random.Generator) -> HardScan:
    """One view, anywhere in the order, whose depth is scaled or shifted."""
    views = _record_bin(pile, random, int(random.integers(*SETTINGS.views, endpoint=True)))
    wrong, off = int(random.integers(len(views))), random.uniform(*SETTINGS.short_m)
    off *= random.choice([-1, 1])
    depth = views[wrong].depth
    assert depth is not None  # recordings have depth
    scaling = random.random() < 0.5
    changed = depth * (1 + off / float(np.median(depth[depth > 0]))) if scaling else depth + off
    views[wrong] = replace(views[wrong], depth=np.where(
        depth > 0, np.maximum(changed, 0), 0).astype(np.float32))
    return HardScan(f"view {wrong + 1} of {len(views)} {'scaled' if scaling else 'shifted'} by "
                    f"{1000 * off:+.0f} mm", views, pile.truth.unit_volume, len(pile.poses))


def make_views_swapped(pile: Scene, random: np.random.Generator) -> HardScan:
    """The poses of two views exchanged."""
    views = _record_bin(pile, random, int(random.integers(*SETTINGS.views, endpoint=True)))
    a, b = sorted(random.choice(len(views), 2, replace=False).tolist())
    T_a, T_b = views[a].T_world_camera, views[b].T_world_camera
    views[a] = replace(views[a], T_world_camera=T_b)
    views[b] = replace(views[b], T_world_camera=T_a)
    return HardScan(f"poses of views {a + 1} and {b + 1} of {len(views)} exchanged", views,
                    pile.truth.unit_volume, len(pile.poses))


def make_arm_in_view(pile: Scene, random: np.random.Generator) -> HardScan:
    """An arm over the bin in some or all views, or the gripper beside the camera in all."""
    number = SETTINGS.views[1]
    bin_ = placed(pile, np.zeros(3), random.uniform(0, np.pi))
    poses = arc_poses(*bin_.bounds(), number, random)
    kind = ("moving arm", "resting arm", "gripper")[random.integers(3)]
    if kind == "gripper":
        gripper = _gripper(random)
        foreground = [[_moved(body, T) for body in gripper] for T in poses]
    elif kind == "resting arm":
        foreground = [_draw_clear_arm(bin_, poses, random)] * number
    else:
        shown = random.permutation(number) < random.integers(1, 4)
        foreground = [_draw_clear_arm(bin_, [T], random) if is_shown else []
                      for is_shown, T in zip(shown, poses)]
    views = record_world([floor(), *scene_meshes(bin_)], poses, random, foreground=foreground)
    in_view = sum(bool(bodies) for bodies in foreground)
    return HardScan(f"{kind} in {in_view} of {number} views", views, pile.truth.unit_volume,
                    len(pile.poses))


def _record_bin(pile: Scene, random: np.random.Generator, views: int) -> list[View]:
    """Views of the bin on the floor, without faults."""
    bin_ = placed(pile, np.zeros(3), random.uniform(0, np.pi))
    poses = arc_poses(*bin_.bounds(), views, random)
    return record_world([floor(), *scene_meshes(bin_)], poses, random)


def _draw_clear_arm(bin_: Scene, poses: list[np.ndarray], random: np.random.Generator
                    ) -> list[Mesh]:
    """Upper arm, forearm and hand of an arm that stands beside the bin, clear of the cameras.

    Cylinders in the world; `poses` are those of the cameras that see the arm.
    """
    while True:
        radius, joints = random.uniform(*SETTINGS.link_radius_m), _draw_joints(bin_, random)
        links = list(zip(joints, joints[1:]))
        if min(_distance_to_link(T[:3, 3], *link) for T in poses for link in links) \
                > radius + SETTINGS.clearance_m:
            return [solid(trimesh.creation.cylinder(radius, segment=np.array(ends)))
                    for ends in links]


def _draw_joints(bin_: Scene, random: np.random.Generator) -> list[np.ndarray]:
    """Base, elbow, wrist and hand (3,) of an arm, world, metres; the hand is over the bin."""
    azimuth, size = random.uniform(0, 2 * np.pi), outer_size(bin_)
    base = random.uniform(*SETTINGS.base_m) * np.array([np.cos(azimuth), np.sin(azimuth), 0])
    hand = np.append(random.uniform(-0.3, 0.3, 2) * size[:2],
                     size[2] + random.uniform(*SETTINGS.hand_above_m))
    elbow = 0.6 * base + 0.4 * hand + [0, 0, SETTINGS.elbow_m]
    return [base, elbow, hand + [0, 0, SETTINGS.hand_length_m], hand]


def _distance_to_link(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Distance of a point from the middle line of a link, all (3,), metres."""
    along = end - start
    share = np.clip((point - start) @ along / (along @ along), 0, 1)
    return float(np.linalg.norm(start + share * along - point))


def _gripper(random: np.random.Generator) -> list[trimesh.Trimesh]:
    """Two fingers at the image's upper border, in the camera's optical frame."""
    size = np.array(SETTINGS.finger_size_m)
    z = random.uniform(*SETTINGS.finger_from_camera_m)
    bodies = []
    for side in (-1, 1):
        finger = trimesh.creation.box(size)
        finger.apply_translation([side * random.uniform(0.02, 0.05), -0.3 * z, z])
        bodies.append(finger)
    return bodies


def _moved(body: trimesh.Trimesh, T: np.ndarray) -> Mesh:
    """A body moved by T (4, 4)."""
    return Mesh(geometry.apply(T, np.asarray(body.vertices)).astype(np.float32),
                np.asarray(body.faces, np.int32))
