"""Drops parts into a bin or on a heap with PhysX 5 (sapien), until they rest.

Lengths are scaled so that a part is one unit: the engine's tolerances are made for that size.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from stack_counter import geometry
from stack_counter.sim.collision import convex_pieces
from stack_counter.sim.scene import Scene, SceneError
from stack_counter.sim.shapes import Shape, make_shape
from stack_counter.types import Container

_STEP_S = 1 / 60
_WAVE_S = 0.6  # simulated time between two waves of parts
_SETTLE_S = 6.0  # longest simulated time after the last wave
_STILL = 0.05  # units/s below which a part rests
_MAX_PENETRATION = 0.02  # of the part size
_MIN_PARTS, _MAX_PARTS = 20, 400
_TRIES = 8


@dataclass(frozen=True)
class Plan:
    """What to drop where; lengths in part sizes.

    `inner` is width, length and depth (depth 0: heap, width and length are those of the column
    that the parts fall from); `fill` the wanted share of the depth.
    """

    shape: Shape
    inner: np.ndarray
    wall: float
    floor: float
    fill: float
    friction: float
    restitution: float


def make_plan(random: np.random.Generator, family: str | None = None) -> Plan:
    """A random part in a random bin (two of three) or on a heap."""
    shape = make_shape(int(random.integers(2**31)), family)
    width = random.uniform(4, 10)
    length = width * random.uniform(1, 1.6)
    heap = random.random() < 1 / 3
    depth = 0.0 if heap else width * random.uniform(0.4, 0.9)
    if heap:
        width, length = 0.45 * width, 0.45 * width
    wall = width * random.uniform(0.005, 0.08)
    return Plan(shape, np.array([width, length, depth]), wall, wall * random.uniform(0.8, 1.2),
                random.uniform(0.3, 0.95), random.uniform(0.2, 0.7), random.uniform(0, 0.3))


def make_scene(seed: int, index: int, skipped: Counter[str] | None = None) -> Scene:
    """Scene `index` of a run: depends on (seed, index) alone, retries included.

    Args:
        skipped: counts the reasons of failed tries.

    Raises:
        SceneError: no try came to rest.
    """
    reasons: Counter[str] = Counter()
    for attempt in range(_TRIES):
        random = np.random.default_rng([seed, index, attempt])
        try:
            return drop(make_plan(random), random, seed, index)
        except SceneError as error:
            reason = str(error).split(":")[0]
            reasons[reason] += 1
            if skipped is not None:
                skipped[reason] += 1
    raise SceneError(f"scene {index} of seed {seed} failed {_TRIES} times: {dict(reasons)}")


def drop(plan: Plan, random: np.random.Generator, seed: int, index: int) -> Scene:
    """Simulates one plan.

    Raises:
        SceneError: it does not rest, parts penetrate, or too few stay.
    """
    size, count = plan.shape.part_size, _wanted_count(plan)
    pile = _Pile(plan, convex_pieces(plan.shape))
    for begin in range(0, count, pile.per_wave):
        pile.add_wave(min(pile.per_wave, count - begin), random)
        pile.run(_WAVE_S)
    pile.settle()
    poses = pile.poses()
    poses[:, :3] *= size
    container = _container(plan, random)
    poses = poses[_inside(poses[:, :3], plan)]
    if len(poses) < _MIN_PARTS:
        raise SceneError(f"too few: {len(poses)} parts stayed; expected {_MIN_PARTS} or more")
    return Scene(seed, index, plan.shape, container, _placed(poses, container))


def _wanted_count(plan: Plan) -> int:
    width, length, depth = plan.inner * plan.shape.part_size
    guess = 0.55 * plan.shape.convexity**0.5  # of the space; only sets how high it fills
    volume = width * length * depth * plan.fill if depth else 4 * width**3 * plan.fill
    return int(np.clip(volume * guess / plan.shape.unit_volume, _MIN_PARTS + 4, _MAX_PARTS))


def _container(plan: Plan, random: np.random.Generator) -> Container:
    size, yaw = plan.shape.part_size, random.uniform(-np.pi, np.pi)
    c, s = np.cos(yaw), np.sin(yaw)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
                      np.array([*random.uniform(-0.05, 0.05, 2), 0.0]))
    width, length, depth = (plan.inner * size).tolist()
    if not depth:
        return Container("none", T)
    return Container("box", T, (width, length, depth), plan.wall * size, plan.floor * size)


def _inside(positions: np.ndarray, plan: Plan) -> np.ndarray:
    """(n,) bool: the centroid lies over the inner opening, or in the heap's reach."""
    if not plan.inner[2]:
        return np.linalg.norm(positions[:, :2], axis=1) < 8 * plan.shape.part_size
    half = plan.inner[:2] * plan.shape.part_size / 2
    return np.all(np.abs(positions[:, :2]) < half, axis=1) & (positions[:, 2] > 0)


def _placed(poses: np.ndarray, container: Container) -> np.ndarray:
    """(n, 7) float32 poses in the world, from poses in the container's frame."""
    out = np.empty((len(poses), 7), np.float32)
    for i, p in enumerate(poses):
        T = container.T_world_container @ geometry.pose_from_quaternion(p[3:], p[:3])
        out[i, :3], out[i, 3:] = T[:3, 3], geometry.quaternion_from_pose(T)
    return out


class _Pile:
    """One physics scene, lengths in part sizes."""

    def __init__(self, plan: Plan, pieces: list[np.ndarray]):
        import sapien  # here: rendering and truth of saved scenes work without the engine

        sapien.physx.set_shape_config(contact_offset=0.04, rest_offset=0.0)
        sapien.physx.set_body_config(solver_position_iterations=8 if len(pieces) < 4 else 16)
        sapien.physx.set_scene_config(enable_tgs=True)
        self._sapien, self._plan = sapien, plan
        self._scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        self._scene.set_timestep(_STEP_S)
        self._material = sapien.physx.PhysxMaterial(plan.friction, plan.friction,
                                                    plan.restitution)
        corners = [(p / plan.shape.part_size).astype(np.float32) for p in pieces]
        self._reach = float(max(np.linalg.norm(c, axis=1).max() for c in corners)) * 2.02
        self._collisions = [sapien.physx.PhysxCollisionShapeConvexMesh(
            vertices=c, scale=np.ones(3, np.float32), material=self._material) for c in corners]
        self._bodies: list[Any] = []
        self._build()
        inner = plan.inner[:2] - self._reach
        self._grid = np.maximum((inner / self._reach).astype(int) + 1, 1)
        self.per_wave = int(np.prod(self._grid)) * 2

    def _build(self) -> None:
        """Support plane, and the bin's floor and walls."""
        width, length, depth = self._plan.inner
        self._static([0, 0, -1], [40, 40, 1])
        if not depth:
            return
        wall, floor = self._plan.wall, self._plan.floor
        self._static([0, 0, floor / 2], [width / 2 + wall, length / 2 + wall, floor / 2])
        rim = floor + depth
        for side in (-1, 1):
            self._static([side * (width + wall) / 2, 0, rim / 2],
                         [wall / 2, length / 2 + wall, rim / 2])
            self._static([0, side * (length + wall) / 2, rim / 2],
                         [width / 2 + wall, wall / 2, rim / 2])

    def _static(self, center: list[float], half: list[float]) -> None:
        builder = self._scene.create_actor_builder()
        builder.add_box_collision(half_size=half, material=self._material)
        builder.set_initial_pose(self._sapien.Pose(center))
        builder.build_static()

    def add_wave(self, count: int, random: np.random.Generator) -> None:
        """Adds parts in random attitudes on a grid above all that is there."""
        top = max([self._plan.floor + self._plan.inner[2]]
                  + [b.entity_pose.p[2] for b in self._bodies]) + self._reach
        cells = int(np.prod(self._grid))
        room = np.maximum(self._plan.inner[:2] - self._grid * self._reach, 0) / 2
        for i in range(count):
            cell = np.array([i % self._grid[0], i // self._grid[0] % self._grid[1]])
            xy = (cell - (self._grid - 1) / 2) * self._reach + random.uniform(-1, 1, 2) * room
            q = random.normal(size=4)
            self._body([*xy, top + i // cells * self._reach], q / np.linalg.norm(q))

    def _body(self, position: list[float], quaternion_wxyz: np.ndarray) -> None:
        body = self._sapien.physx.PhysxRigidDynamicComponent()
        for collision in self._collisions:
            body.attach(collision)
        body.linear_damping = body.angular_damping = 0.5
        entity = self._sapien.Entity()
        entity.add_component(body)
        entity.set_pose(self._sapien.Pose(position, quaternion_wxyz))
        self._scene.add_entity(entity)
        self._bodies.append(body)

    def run(self, seconds: float) -> None:
        """Steps the physics."""
        for _ in range(round(seconds / _STEP_S)):
            self._scene.step()

    def settle(self) -> None:
        """Runs until nearly all parts rest, and checks the result."""
        speed, limit = np.inf, _SETTLE_S
        while limit > 0:
            self.run(0.5)
            limit -= 0.5
            speed = float(np.quantile([np.linalg.norm(b.linear_velocity)
                                       for b in self._bodies], 0.98))
            if speed < _STILL:
                break
            if limit == _SETTLE_S / 2:  # what still rolls has rolling friction in a real cell
                for body in self._bodies:
                    body.linear_damping = body.angular_damping = 5.0
        else:
            raise SceneError(f"unsettled: {speed:.3f} part sizes/s; expected below {_STILL}")
        deep = self._penetration()
        if deep > _MAX_PENETRATION:
            raise SceneError(f"penetration: {deep:.3f} of the part size; expected at most "
                             f"{_MAX_PENETRATION}")

    def _penetration(self) -> float:
        depths = [-point.separation for contact in self._scene.physx_system.get_contacts()
                  for point in contact.points]
        return float(np.quantile(depths, 0.99)) if depths else 0.0

    def poses(self) -> np.ndarray:
        """(n, 7) float64 position and quaternion (x, y, z, w) of each part."""
        return np.array([[*b.entity_pose.p, *np.roll(b.entity_pose.q, -1)]
                         for b in self._bodies], float)
