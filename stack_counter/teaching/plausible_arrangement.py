# SPDX-License-Identifier: Apache-2.0
"""One plausible arrangement of the parts in a counted stack: the nearest of simulated piles.

As many parts as were counted are poured into a container of the measured sizes, several times.
The pile whose top surface is nearest to the measured one stands for all that nobody sees.
"""

from __future__ import annotations

import math
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
        max_draft_deg: largest inclination of the simulated walls from the vertical.
        min_floor_share: least share of the rim's smaller side that is left at the floor.
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
    max_draft_deg: float = 40.0
    min_floor_share: float = 0.3
    min_wall_m: float = 1e-3
    triangles: int = 30_000
    min_triangles: int = 24
    seed: int = 0xA22


SETTINGS = ArrangementSettings()
# Containers whose form is known by their sizes; an outline of any form is not.
KINDS = ("box", "round")


@dataclass(frozen=True, eq=False)
class _Pour:
    """What to pour and what to compare it with, in the frame of the measured map.

    Attributes:
        shape: the part.
        container: the measured container as the simulator makes it.
        count: number of parts.
        friction: least and most.
        top, inner: the measured top surface, and the container's inner surface on the same grid.
    """

    shape: Shape
    container: ContainerShape
    count: int
    friction: tuple[float, float]
    top: HeightMap
    inner: HeightMap


@dataclass(frozen=True, eq=False)
class _Pile:
    """A pile in the turn that is nearest to the measured surface.

    Attributes:
        scene: the pile; None where no try came to rest.
        difference_m: mean absolute difference in height, metres.
        failure: what was wrong with the last try.
    """

    scene: Scene | None
    difference_m: float = math.inf
    failure: str = ""


def find_arrangement(count: StackCount, shape: Shape, friction: tuple[float, float] | None,
                     workers: int) -> Arrangement:
    """Simulates piles of the counted parts and takes the one nearest in height.

    Args:
        count: final count of an open container.
        shape: the part.
        friction: least and most, of parts on each other; None where it is not known.
        workers: number of processes.

    Raises:
        PartError: it is no box or round container, there is no part or there are too many, no
            pile of them comes to rest, or none of its parts lies below the measured surface.
        ShapeError: the mesh is no solid.
    """
    pour = _plan_pour(count, shape, friction or FRICTION)
    with worker_pool(min(workers, SETTINGS.piles)) as pool:
        jobs = [pool.submit(_nearest_turn, pour, index) for index in range(SETTINGS.piles)]
        piles = [job.result() for job in jobs]
    nearest = min(piles, key=lambda pile: pile.difference_m)
    if nearest.scene is None:
        raise PartError(f"no arrangement: none of {SETTINGS.piles} piles of {count.count} parts "
                        f"came to rest in {SETTINGS.max_tries} tries each, the last by "
                        f"{nearest.failure}")
    hidden = _hidden_poses(nearest.scene, pour.top)
    if not len(hidden):
        raise PartError(f"no arrangement: none of {count.count} simulated parts lies below the "
                        "measured surface; expected a deeper stack")
    return Arrangement(
        _simplified_part(shape, len(hidden)), pour.top.T_world_map @ hidden,
        len(nearest.scene.poses), nearest.difference_m,
        sum(pile.scene is not None for pile in piles))


def _plan_pour(count: StackCount, shape: Shape, friction: tuple[float, float]) -> _Pour:
    """What to pour for a count.

    Raises:
        PartError: it is no box or round container, there is no part or there are too many.
        ShapeError: the mesh is no solid.
    """
    volume = count.volume
    if volume.top is None or volume.inner is None or volume.container.kind not in KINDS:
        raise PartError(f"no arrangement: the scan shows a '{volume.container.kind}'; expected "
                        f"an open container of known form ({', '.join(KINDS)})")
    most = max_simulated_parts(shape) if count.count else 0  # caches its pieces for the workers
    if not 1 <= count.count <= most:
        raise PartError(f"no arrangement: {count.count} parts were counted; expected 1 to "
                        f"{most or 'some'} of this form, which are simulated within minutes")
    return _Pour(shape, _container_in_map(volume), count.count, friction, volume.top,
                 volume.inner)


def _simplified_part(shape: Shape, count: int) -> Mesh:
    """One part, with so few triangles that as many as `count` can be shown."""
    coarse = simplify_solid(trimesh.Trimesh(shape.vertices, shape.faces, process=False),
                            max(SETTINGS.triangles // count, SETTINGS.min_triangles))
    return Mesh(coarse.vertices.astype(np.float32), coarse.faces.astype(np.int32))


def _container_in_map(volume: StackVolume) -> ContainerShape:
    """The measured container in the frame of the map.

    Its draft follows from how large the opening is half-way down, where no rib of the floor
    reaches; a bowl becomes a cone.
    """
    container, inner = volume.container, volume.inner
    assert inner is not None  # checked by the caller
    x, y, depth = container.inner_size_m
    # Half-way down lies the rim's rectangle, moved inwards all around until its share is left.
    below = inner.heights < container.floor_thickness_m + depth / 2
    share = np.count_nonzero(below) / max(np.count_nonzero(np.isfinite(inner.heights)), 1)
    inwards = (x + y - math.sqrt((x + y) ** 2 - 4 * x * y * (1 - share))) / 4
    slope = min(inwards / (depth / 2), math.tan(math.radians(SETTINGS.max_draft_deg)),
                (1 - SETTINGS.min_floor_share) * min(x, y) / 2 / depth)
    return ContainerShape(
        SIMULATED_KIND[container.kind],
        geometry.inverse(inner.T_world_map) @ container.T_world_container, (x, y, depth),
        max(container.wall_thickness_m, SETTINGS.min_wall_m),
        max(container.floor_thickness_m, SETTINGS.min_wall_m), math.atan(slope))


def _nearest_turn(pour: _Pour, index: int) -> _Pile:
    """Pile `index` in the turn about its container's axis that is nearest."""
    failure = ""
    for attempt in range(SETTINGS.max_tries):
        random = np.random.default_rng([SETTINGS.seed, index, attempt])
        try:
            scene = simulate_pile(
                plan_pour(random, pour.shape, pour.container, pour.friction, pour.count),
                random, SETTINGS.seed, index)
        except SceneError as error:
            failure = str(error)
            continue
        caster = RayCaster(scene.parts_mesh())
        turns = [(_height_difference(caster, turn, pour), turn)
                 for turn in _alike_turns(pour.container)]
        difference, turn = min(turns, key=lambda pair: pair[0])
        turned = turn @ scene.container.T_world_container
        return _Pile(replace(scene, container=replace(scene.container, T_world_container=turned)),
                     difference)
    return _Pile(None, failure=failure)


def _alike_turns(container: ContainerShape) -> list[np.ndarray]:
    """(4, 4) motions of the map's frame that leave the container as it is."""
    x, y, _ = container.inner_size_m
    turns = SETTINGS.round_turns if container.kind == "cylinder" else \
        4 if max(x, y) < SETTINGS.square_ratio * min(x, y) else 2
    to_container = geometry.inverse(container.T_world_container)
    half_angles = math.pi * np.arange(turns) / turns
    return [container.T_world_container @ geometry.pose_from_quaternion(
        np.array([0, 0, math.sin(half), math.cos(half)]), np.zeros(3)) @ to_container
        for half in half_angles]


def _height_difference(caster: RayCaster, turn: np.ndarray, pour: _Pour) -> float:
    """Mean absolute difference between a turned pile's top surface and the measured one, metres.

    Args:
        caster: of the pile as it was poured.
        turn: (4, 4) motion of the map's frame by which it is turned.
        pour: with the measured surface.
    """
    rows, cols = np.nonzero(np.isfinite(pour.top.heights) & np.isfinite(pour.inner.heights))
    places = np.stack([(cols + 0.5) * pour.top.pitch, (rows + 0.5) * pour.top.pitch,
                       np.zeros(len(rows))], axis=-1)
    poured = geometry.apply(geometry.inverse(turn), places)[:, :2]
    heights = np.maximum(caster.surface_heights(poured), pour.inner.heights[rows, cols])
    return float(np.abs(heights - pour.top.heights[rows, cols]).mean())


def _hidden_poses(scene: Scene, top: HeightMap) -> np.ndarray:
    """(n, 4, 4) poses, in the map's frame, of the parts that lie below the measured surface."""
    poses = scene.part_poses()
    # How far each part's highest corner stands out of the surface over it
    corners = scene.parts_mesh().vertices.reshape(len(poses), -1, 3)
    above = np.nan_to_num(corners[..., 2] - _heights_at(top, corners[..., :2]), nan=-np.inf)
    allowed = SETTINGS.protrusion * scene.shape.unit_volume ** (1 / 3)
    measured = np.isfinite(_heights_at(top, poses[:, :2, 3]))
    return poses[measured & (above.max(axis=1) < allowed)]


def _heights_at(top: HeightMap, xy: np.ndarray) -> np.ndarray:
    """(...) heights of the cells nearest to points (..., 2) of the map's frame, metres."""
    cols, rows = np.moveaxis(np.floor(xy / top.pitch).astype(int), -1, 0)
    rows, cols = (np.clip(i, 0, n - 1) for i, n in zip((rows, cols), top.heights.shape))
    return top.heights[rows, cols]
