# SPDX-License-Identifier: Apache-2.0
"""Hard because of what there is: a few large parts, a sheet on the parts, or no bin at all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.sim.camera.recording import arc_poses
from stack_counter.sim.hard.piles import part_extents, placed
from stack_counter.sim.hard.scan import HardScan
from stack_counter.sim.hard.world import block, floor, record_world, scene_meshes, solid
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import Mesh


@dataclass(frozen=True)
class ContentSettings:
    """What lies there; all chosen.

    Attributes:
        views: of each scan.
        few: least and largest number of large parts.
        part_size_m: range of their size.
        bin_parts: range of their bin's inner side, in part sizes.
        depth_parts: range of its depth, in part sizes.
        wall_m: thickness of its walls and floor.
        tries: places that are tried for a part.
        cover_share: range of the share of a bin's inner side that a sheet covers.
        cover_m: its thickness.
        cover_tilt_rad: range of its slope.
        room_m: range of the distance of a room's walls from its middle.
        eye_m, eye_height_m: range of a camera's place there, x and y, and z.
        clutter: least and largest number of things on a table.
        thing_m: range of the sides of a thing.
    """

    views: int = 6
    few: tuple[int, int] = (2, 6)
    part_size_m: tuple[float, float] = (0.05, 0.14)
    bin_parts: tuple[float, float] = (2.5, 3.5)
    depth_parts: tuple[float, float] = (0.7, 1.5)
    wall_m: float = 0.003
    tries: int = 200
    cover_share: tuple[float, float] = (0.3, 0.9)
    cover_m: float = 0.0005
    cover_tilt_rad: tuple[float, float] = (-0.1, 0.1)
    room_m: tuple[float, float] = (0.35, 0.6)
    eye_m: tuple[float, float] = (-0.6, -0.05)
    eye_height_m: tuple[float, float] = (0.5, 0.9)
    clutter: tuple[int, int] = (3, 8)
    thing_m: tuple[float, float] = (0.03, 0.15)


SETTINGS = ContentSettings()


def make_few_large(pile: Scene, random: np.random.Generator) -> HardScan:
    """Two to six parts side by side in a bin about three part sizes wide."""
    bin_ = _lay_out(pile, int(random.integers(*SETTINGS.few, endpoint=True)), random)
    poses = arc_poses(*bin_.bounds(), SETTINGS.views, random)
    views = record_world([floor(), *scene_meshes(bin_)], poses, random)
    return HardScan(f"{len(bin_.poses)} parts of {1000 * bin_.shape.part_size:.0f} mm", views,
                    bin_.shape.unit_volume, len(bin_.poses))


def _lay_out(pile: Scene, number: int, random: np.random.Generator) -> Scene:
    """A new bin, and in it up to so many of the pile's lowest parts, as they rest there."""
    factor = random.uniform(*SETTINGS.part_size_m) / pile.shape.part_size
    shape = replace(pile.shape, vertices=pile.shape.vertices * factor)
    side = random.uniform(*SETTINGS.bin_parts) * shape.part_size
    depth = random.uniform(*SETTINGS.depth_parts) * shape.part_size
    container = ContainerShape("bin", inner_size_m=(side, side, depth),
                               wall_thickness_m=SETTINGS.wall_m, floor_thickness_m=SETTINGS.wall_m)
    lowest, reach = (factor * extent for extent in part_extents(pile))
    order, poses, circles = np.argsort(lowest), [], []
    for i in order[random.permutation(min(number, len(order)))]:
        xy = _free_place(circles, reach[i], side, random)
        if xy is None:
            continue
        circles.append((*xy, reach[i]))
        turn = Rotation.from_rotvec([0, 0, random.uniform(0, 2 * np.pi)])
        z = factor * pile.poses[i, 2] - lowest[i] + SETTINGS.wall_m
        poses.append([*xy, z, *(turn * Rotation.from_quat(pile.poses[i, 3:])).as_quat()])
    scene = replace(pile, shape=shape, container=container, poses=np.array(poses),
                    stored_truth=None)
    return placed(scene, np.zeros(3), random.uniform(0, np.pi))


def _free_place(circles: list[tuple[float, float, float]], reach: float, side: float,
                random: np.random.Generator) -> np.ndarray | None:
    """(2,) middle of a circle within a square that meets no other; None if there is no room."""
    room = side / 2 - reach
    for _ in range(SETTINGS.tries if room > 0 else 0):
        xy = random.uniform(-room, room, 2)
        if all(np.hypot(xy[0] - x, xy[1] - y) > reach + r for x, y, r in circles):
            return xy
    return None


def make_covered(pile: Scene, random: np.random.Generator) -> HardScan:
    """A bin with a sheet, as of cardboard or film, that lies on its parts and leans a little."""
    bin_ = placed(pile, np.zeros(3), random.uniform(0, np.pi))
    share, tilt = random.uniform(*SETTINGS.cover_share), random.uniform(*SETTINGS.cover_tilt_rad)
    x, y, _ = pile.container.inner_size_m
    sheet = trimesh.creation.box([share * x, 0.9 * y, SETTINGS.cover_m])
    T = geometry.pose(Rotation.from_euler("y", tilt).as_matrix(), np.zeros(3))
    T[2, 3] = float(np.percentile(bin_.parts_mesh().vertices[:, 2], 99.5)) \
        + abs(np.sin(tilt)) * share * x / 2
    sheet.apply_transform(bin_.container.T_world_container @ T)
    poses = arc_poses(*bin_.bounds(), SETTINGS.views, random)
    views = record_world([floor(), *scene_meshes(bin_), solid(sheet)], poses, random)
    return HardScan(f"a sheet over {share * 0.9:.0%} of the parts, {np.degrees(tilt):.0f} degrees",
                    views, pile.truth.unit_volume, len(pile.poses))


def make_no_bin(pile: Scene, random: np.random.Generator) -> HardScan:
    """The corner of a room, a table with things on it, or an empty one: none of the parts."""
    kind = ("corner of a room", "table with clutter", "empty table")[random.integers(3)]
    if kind == "corner of a room":
        distance = random.uniform(*SETTINGS.room_m)
        meshes = [floor(), block((distance, -2, 0), (distance + 0.1, 2, 2)),
                  block((-2, distance, 0), (2, distance + 0.1, 2)), *_things(distance, 3, random)]
        poses = [geometry.look_at(np.append(random.uniform(*SETTINGS.eye_m, 2),
                                            random.uniform(*SETTINGS.eye_height_m)),
                                  np.append(random.uniform(0, distance, 2), 0.2))
                 for _ in range(SETTINGS.views)]
    else:
        number = int(random.integers(*SETTINGS.clutter, endpoint=True))
        meshes = [floor(), *(_things(0.2, number, random) if "clutter" in kind else [])]
        poses = arc_poses(np.array([-0.2, -0.2, 0]), np.array([0.2, 0.2, 0.1]), SETTINGS.views,
                          random)
    views = record_world(meshes, poses, random)
    return HardScan(kind, views, pile.truth.unit_volume, 0)


def _things(half_side: float, number: int, random: np.random.Generator) -> list[Mesh]:
    """Blocks, cylinders and balls on the floor within a square around the origin."""
    things = []
    for _ in range(number):
        x, y, z = random.uniform(*SETTINGS.thing_m, 3)
        body = (trimesh.creation.box((x, y, z)), trimesh.creation.cylinder(x / 2, z),
                trimesh.creation.icosphere(3, x / 2))[random.integers(3)]
        body.apply_transform(trimesh.transformations.rotation_matrix(
            random.uniform(0, np.pi), [0, 0, 1]))
        body.apply_translation([*random.uniform(-half_side, half_side, 2), -body.bounds[0, 2]])
        things.append(solid(body))
    return things
