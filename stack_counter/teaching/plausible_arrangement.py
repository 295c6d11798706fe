# SPDX-License-Identifier: Apache-2.0
"""One plausible arrangement of the parts in a counted stack: the nearest of simulated piles.

As many parts as were counted are poured into a container of the measured sizes, several times.
The pile whose top surface is nearest to the measured one stands for all that nobody sees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from stack_counter import geometry
from stack_counter.errors import PartError
from stack_counter.sim import (
    FRICTION,
    ContainerShape,
    RayCaster,
    Scene,
    SceneError,
    Shape,
    max_simulated_parts,
    plan_pour,
    simplify_solid,
    simulate_pile,
)
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.teaching.simulated_piles import SIMULATED_KIND
from stack_counter.types import Arrangement, HeightMap, Mesh, StackCount, StackVolume


@dataclass(frozen=True)
class ArrangementSettings:
    """How piles are made and compared; all chosen.

    Attributes:
        piles: number of piles to simulate.
        max_tries: times that a pile is poured anew where it does not come to rest.
        round_turns: turns about its axis in which a pile of a round container is compared.
        square_ratio: ratio of its sides below which a box looks alike after a quarter turn.
        protrusion: part lengths by which a part may stand out of the measured surface and still
            count as lying below it: about what noise and voxels take from it.
        floor_tolerance_m: height above the floor up to which the inner surface is floor, m.
        min_wall_m: least thickness of the simulated wall and floor, m.
        triangles, min_triangles: about how many triangles all parts together are given with, and
            how many one has at least.
        seed: of all piles.
    """

    piles: int = 4
    max_tries: int = 4
    round_turns: int = 24
    square_ratio: float = 1.03
    protrusion: float = 0.15
    floor_tolerance_m: float = 0.002
    min_wall_m: float = 1e-3
    triangles: int = 30_000
    min_triangles: int = 60
    seed: int = 0xA22


SETTINGS = ArrangementSettings()


@dataclass(frozen=True, eq=False)
class _Pour:
    """What to pour and what to compare it with, in the frame of the measured map.

    Attributes:
        shape: the part.
        container: the measured container as the simulator makes it.
        count: number of parts.
        friction: least and most.
        top: the measured top surface.
    """

    shape: Shape
    container: ContainerShape
    count: int
    friction: tuple[float, float]
    top: HeightMap


def find_arrangement(count: StackCount, shape: Shape, friction: tuple[float, float] | None,
                     workers: int) -> Arrangement:
    """Simulates piles of the counted parts and takes the one nearest in height.

    Args:
        count: final count of an open container.
        shape: the part.
        friction: least and most, of parts on each other; None where it is not known.
        workers: number of processes.

    Raises:
        PartError: there is no container or no part, there are too many parts, or no pile of them
            comes to rest.
        ShapeError: the mesh is no solid.
    """
    top = count.volume.top
    most = max_simulated_parts(shape)  # its convex pieces are cached for the workers
    if top is None or count.volume.inner is None or count.volume.container.kind \
            not in SIMULATED_KIND:
        raise PartError(f"no arrangement: the scan shows a '{count.volume.container.kind}'; "
                        f"expected an open container ({', '.join(SIMULATED_KIND)}), in which "
                        "parts can be poured")
    if not 1 <= count.count <= most:
        raise PartError(f"no arrangement: {count.count} parts were counted; expected 1 to {most} "
                        "of this form, which are simulated within minutes")
    pour = _Pour(shape, _container_in_map(count.volume), count.count, friction or FRICTION, top)
    with worker_pool(min(workers, SETTINGS.piles)) as pool:
        jobs = [pool.submit(_nearest_turn, pour, index) for index in range(SETTINGS.piles)]
        found = [job.result() for job in jobs]
    piles = [pile for pile in found if pile is not None]
    if not piles:
        raise PartError(f"no arrangement: none of {SETTINGS.piles} piles of {count.count} parts "
                        f"came to rest in {SETTINGS.max_tries} tries each; check the part's mesh")
    difference, scene = min(piles, key=lambda pile: pile[0])
    hidden = _hidden_poses(scene, top)
    return Arrangement(_simplified_part(shape, len(hidden)), top.T_world_map @ hidden,
                       len(scene.poses), difference, len(piles))


def _simplified_part(shape: Shape, count: int) -> Mesh:
    """One part, with so few triangles that as many as `count` can be shown."""
    coarse = simplify_solid(trimesh.Trimesh(shape.vertices, shape.faces, process=False),
                            max(SETTINGS.triangles // max(count, 1), SETTINGS.min_triangles))
    return Mesh(coarse.vertices.astype(np.float32), coarse.faces.astype(np.int32))


def _container_in_map(volume: StackVolume) -> ContainerShape:
    """The measured container in the frame of the map; its draft by how small its floor is."""
    container, inner = volume.container, volume.inner
    assert inner is not None  # checked by the caller
    x, y, depth = container.inner_size_m
    # The floor is the rim's rectangle, moved inwards all around until its share is left.
    floor = inner.heights < container.floor_thickness_m + SETTINGS.floor_tolerance_m
    share = np.count_nonzero(floor) / max(np.count_nonzero(np.isfinite(inner.heights)), 1)
    inwards = (x + y - math.sqrt((x + y) ** 2 - 4 * x * y * (1 - share))) / 4
    return ContainerShape(
        SIMULATED_KIND[container.kind],
        geometry.inverse(inner.T_world_map) @ container.T_world_container, (x, y, depth),
        max(container.wall_thickness_m, SETTINGS.min_wall_m),
        max(container.floor_thickness_m, SETTINGS.min_wall_m),
        math.atan2(inwards, depth))


def _nearest_turn(pour: _Pour, index: int) -> tuple[float, Scene] | None:
    """Pile `index` in the turn that is nearest, and how far that is, metres.

    None where no try came to rest.
    """
    for attempt in range(SETTINGS.max_tries):
        random = np.random.default_rng([SETTINGS.seed, index, attempt])
        try:
            scene = simulate_pile(
                plan_pour(random, pour.shape, pour.container, pour.friction, pour.count),
                random, SETTINGS.seed, index)
        except SceneError:
            continue
        turned = [(_height_difference(turn, pour.top), turn) for turn in _alike_turns(scene)]
        return min(turned, key=lambda pile: pile[0])
    return None


def _alike_turns(scene: Scene) -> Iterator[Scene]:
    """The pile in all turns about its container's axis that leave the container as it is."""
    container = scene.container
    x, y, _ = container.inner_size_m
    turns = {"cylinder": SETTINGS.round_turns, "bag": 1}.get(
        container.kind, 4 if max(x, y) < SETTINGS.square_ratio * min(x, y) else 2)
    for turn in range(turns):
        half = math.pi * turn / turns
        rotation = geometry.pose_from_quaternion(
            np.array([0, 0, math.sin(half), math.cos(half)]), np.zeros(3))
        yield replace(scene, container=replace(
            container, T_world_container=container.T_world_container @ rotation))


def _height_difference(scene: Scene, top: HeightMap) -> float:
    """Mean absolute difference between the pile's top surface and the measured one, metres."""
    rows, cols = np.nonzero(np.isfinite(top.heights))
    xy = (np.stack([cols, rows], axis=-1) + 0.5) * top.pitch
    floor = scene.container.floor_thickness_m
    heights = np.maximum(RayCaster(scene.parts_mesh()).surface_heights(xy), floor)
    return float(np.abs(heights - top.heights[rows, cols]).mean())


def _hidden_poses(scene: Scene, top: HeightMap) -> np.ndarray:
    """(n, 4, 4) poses, in the map's frame, of the parts that lie below the measured surface."""
    # How far each part's highest corner stands out of the surface over it
    corners = scene.parts_mesh().vertices.reshape(len(scene.poses), -1, 3)
    cols, rows = np.floor(corners[..., :2] / top.pitch).astype(int).transpose(2, 0, 1)
    rows, cols = (np.clip(i, 0, n - 1) for i, n in zip((rows, cols), top.heights.shape))
    above = np.nan_to_num(corners[..., 2] - top.heights[rows, cols], nan=-np.inf)
    allowed = SETTINGS.protrusion * scene.shape.unit_volume ** (1 / 3)
    return scene.part_poses()[above.max(axis=1) < allowed]
