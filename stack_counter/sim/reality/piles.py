# SPDX-License-Identifier: Apache-2.0
"""One simulated pile of an experiment, and the share of it that parts fill."""

from __future__ import annotations

import time
import zlib
from dataclasses import dataclass

import numpy as np

from stack_counter.sim.physics import plans
from stack_counter.sim.physics.drop import simulate_pile
from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.reality.experiments import DENSE, LOOSE, Experiment, Tub, counted_volume
from stack_counter.sim.scenes.containers import ContainerShape, polygon_area
from stack_counter.sim.scenes.ray_caster import RayCaster
from stack_counter.sim.scenes.scene import Scene, SceneError, rotation_matrices
from stack_counter.sim.scenes.truth import sample_inside
from stack_counter.sim.shapes import Shape


@dataclass(frozen=True)
class RealitySettings:
    """The simulated piles; chosen. Lengths are in part sizes, if no unit is named.

    Attributes:
        depth: depth of a pile of bulk over its width.
        freeboard: depth of a vessel over that of the pile: nothing is to fall over its rim.
        expected_share: most that hulls fill, where a box is chosen for a number of parts, or a
            number for a tub; of long rods it is what was measured. No result depends on it.
        overfill: height of the parts that a tub holds over its rim before they are struck off.
        margin: what is left out at walls, floor and top where the bulk is measured...
        margin_share: ... and at most this share of the width.
        clearance: least height of the surface over the level of a tub.
        restitution: of all contacts.
        column, round_column: side of the poured column over that of the vessel.
        wall: thickness of walls and floor.
        points: about how many points inside a part stand for its volume.
        max_tries: seeds tried for a pile.
    """

    depth: float = 1.1
    freeboard: float = 1.4
    expected_share: float = 0.57
    overfill: float = 1.5
    margin: float = 1.0
    margin_share: float = 0.25
    clearance: float = 0.3
    restitution: float = 0.1
    column: float = 0.95
    round_column: float = 0.7
    wall: float = 0.2
    points: int = 256
    max_tries: int = 5


SETTINGS = RealitySettings()


@dataclass(frozen=True)
class Pile:
    """What one simulated pile gave.

    Attributes:
        share: of the bulk volume, as the experiment's.
        tries: piles that were begun until one came to rest without overlap.
        cpu_s: CPU seconds of all tries.
    """

    share: float
    tries: int
    cpu_s: float


def friction_of(pour: str) -> float:
    """Friction of a pour: the ends of the sets' range for the loosest and the densest state.

    For what is poured it is the median of the log-uniform range between them.
    """
    low, high = plans.FRICTION
    return {LOOSE: high, DENSE: low}.get(pour, float(np.sqrt(low * high)))


def simulate_experiment(experiment: Experiment, seed: int, friction: float) -> Pile:
    """Pours one pile and measures it.

    Args:
        experiment: what to pour into what.
        seed: of the pile.
        friction: of all contacts.

    Raises:
        SceneError: no try came to rest.
    """
    start, shape, last = time.process_time(), experiment.part(), ""
    plan = plan_experiment(experiment, shape, friction)
    stream = zlib.crc32(f"{experiment.name} {experiment.pour}".encode())
    for attempt in range(SETTINGS.max_tries):
        try:
            scene = simulate_pile(plan, np.random.default_rng([stream, seed, attempt]))
            share = measure_tub(scene, experiment.tub) if experiment.tub else measure_bulk(scene)
        except SceneError as error:
            last = str(error)
            continue
        share *= counted_volume(experiment, shape) / shape.unit_volume
        return Pile(share, attempt + 1, time.process_time() - start)
    raise SceneError(f"{experiment.name}: no try of {SETTINGS.max_tries} came to rest: {last}")


def plan_experiment(experiment: Experiment, shape: Shape, friction: float) -> PilePlan:
    """The vessel and the number of parts: a wide box for values of the bulk."""
    hull = float(shape.mesh.convex_hull.volume)
    if experiment.tub:
        tub, share = experiment.tub, SETTINGS.round_column
        depth = tub.depth_m + SETTINGS.overfill * shape.part_size
        count = round(SETTINGS.expected_share * np.pi / 4 * tub.diameter_m**2 * depth / hull)
        vessel = round_vessel(tub, SETTINGS.freeboard * depth, shape)
    else:
        count, share = experiment.bodies, SETTINGS.column
        filled = min(SETTINGS.expected_share, experiment.measured_share(shape))
        side = (count * hull / filled / SETTINGS.depth) ** (1 / 3)
        depth, wall = SETTINGS.freeboard * SETTINGS.depth * side, SETTINGS.wall * shape.part_size
        vessel = ContainerShape("bin", np.eye(4), (side, side, depth), wall, wall)
    column = share * np.array(vessel.inner_size_m[:2])
    return PilePlan(shape, vessel, column, count, friction, SETTINGS.restitution)


def round_vessel(tub: Tub, depth_m: float, shape: Shape) -> ContainerShape:
    """A tub with walls of any height."""
    wall = SETTINGS.wall * shape.part_size
    return ContainerShape("cylinder", np.eye(4), (tub.diameter_m, tub.diameter_m, depth_m), wall,
                          wall)


def measure_bulk(scene: Scene) -> float:
    """Gamma away from walls, floor and surface."""
    width, floor = scene.container.inner_size_m[0], scene.container.floor_thickness_m
    margin = min(SETTINGS.margin * scene.shape.part_size, SETTINGS.margin_share * width)
    half = width / 2 - margin
    bottom, top = floor + margin, _mean_height(scene, half) - margin
    if top <= bottom:
        raise SceneError(f"too shallow: the pile ends at {top:.4f} m less a margin; expected more "
                         f"than {bottom:.4f} m")
    points = _points_inside(scene)
    within = (np.abs(points[..., :2]) < half).all(axis=-1) \
        & (points[..., 2] > bottom) & (points[..., 2] < top)
    return float(within.mean(axis=1).sum() * scene.shape.unit_volume
                 / ((2 * half) ** 2 * (top - bottom)))


def measure_tub(scene: Scene, tub: Tub) -> float:
    """Gamma below the level of the rim, as if the rest were struck off."""
    level = scene.container.floor_thickness_m + tub.depth_m
    height = _mean_height(scene, tub.diameter_m / 2)
    least = level + SETTINGS.clearance * scene.shape.part_size
    if height < least:
        raise SceneError(f"tub not full: the surface is at {height:.4f} m; expected {least:.4f} m "
                         "or more")
    below = _points_inside(scene)[..., 2] < level
    area = float(polygon_area(scene.container.opening))
    return float(below.mean(axis=1).sum() * scene.shape.unit_volume / (area * tub.depth_m))


def _points_inside(scene: Scene) -> np.ndarray:
    """(parts, points, 3) points spread inside each part, container frame, metres."""
    points = sample_inside(scene.shape, SETTINGS.points)
    return np.einsum("nij,pj->npi", rotation_matrices(scene.poses), points) \
        + scene.poses[:, None, :3]


def _mean_height(scene: Scene, half: float) -> float:
    """Mean height of the surface over the middle square, or circle of a tub, of half a width."""
    side = np.linspace(-half, half, 120)
    xy = np.stack(np.meshgrid(side, side), axis=-1)
    within = scene.container.is_over_opening(xy)
    heights = RayCaster(scene.parts_mesh()).surface_heights(xy[within])
    return float(np.maximum(heights, scene.container.floor_thickness_m).mean())
