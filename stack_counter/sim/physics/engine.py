# SPDX-License-Identifier: Apache-2.0
"""Drops parts into a container or on a heap with PhysX 5 (sapien), until they rest.

Lengths are scaled so that a part is one unit: the engine's tolerances are made for that size.
Every pile has an engine scene of its own, so that it does not depend on what was made before it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.scenes.scene import SceneError


@dataclass(frozen=True)
class ContactSettings:
    """How contacts are found and solved.

    Attributes:
        offset: distance from which contacts are made, in part sizes.
        iterations: position iterations of the solver.
    """

    offset: float
    iterations: int


@dataclass(frozen=True)
class EngineSettings:
    """How piles are poured and when they rest; lengths in part sizes (units).

    Chosen where nothing else is said; what comes out is compared with real piles by
    `python -m stack_counter.sim.reality`.

    Attributes:
        step_s: simulated seconds of one step. At friction 0.35 a pile of cubes had gamma 0.525
            at 1/60 s, 0.552 at this and 0.545 at 1/240 s, for twice the time; at 0.1 they differ
            by less than piles do (2 to 3%).
        convex_contacts: of parts of one piece. With 16 iterations piles come to rest no sooner,
            and 8 keep the overlap below the limit; from nearer contacts cubes creep.
        pieces_contacts: of parts of several pieces. Their walls are thin, and from 0.04 pieces
            of both sides of a wall would make contacts: 1.2 to 1.6 times the time, the same
            gamma within 3%.
        falling_damping, resting_damping: linear and angular damping per second while parts fall,
            and once they have landed: what still rolls has rolling friction in a real cell.
        spacing: distance of dropped parts, in their largest radius.
        layers: layers of parts in a wave.
        wave_s: simulated seconds between two waves.
        check_s: simulated seconds over which speeds are measured.
        fall_s, settle_s: longest simulated time until parts have landed, and until they rest.
        jolted_s: simulated seconds that landed parts go on with the friction of the plan. With
            6 s gamma of balls, octahedra and dodecahedra is the same within 0.003.
        resting_friction: least friction after that.
        landed_share, landed_speed: the fall is over when that share of the parts is slower than
            that, units/s.
        rest_speed: speed of the fastest part at rest, units/s.
        mostly_rest_share, mostly_rest_speed: at rest that share of the parts is slower than that,
            units/s.
        tap_s: simulated seconds after each tap on the container.
        tap_speed: upward speed that a tap gives, units/s.
        tap_aside: largest sideways share of it.
        ground_size: half sides of the block under the support plane.
    """

    step_s: float = 1 / 120
    convex_contacts: ContactSettings = ContactSettings(0.04, 8)
    pieces_contacts: ContactSettings = ContactSettings(0.012, 4)
    falling_damping: float = 0.5
    resting_damping: float = 5.0
    spacing: float = 2.02
    layers: int = 3
    wave_s: float = 0.4
    check_s: float = 0.25
    fall_s: float = 8.0
    settle_s: float = 6.0
    jolted_s: float = 1.0
    resting_friction: float = 0.6
    landed_share: float = 0.98
    landed_speed: float = 0.5
    rest_speed: float = 0.1
    mostly_rest_share: float = 0.95
    mostly_rest_speed: float = 0.05
    tap_s: float = 0.4
    tap_speed: float = 1.2
    tap_aside: float = 0.6
    ground_size: tuple[float, float, float] = (60, 60, 1)


SETTINGS = EngineSettings()


class PileSimulation:
    """One physics scene, lengths in part sizes, container frame."""

    def __init__(self, plan: PilePlan, pieces: list[np.ndarray], random: np.random.Generator):
        """Builds an empty container on the support plane.

        Args:
            plan: what will be dropped where.
            pieces: corners (n, 3) of the part's convex pieces, metres.
            random: draws attitudes and places.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the graphics driver, which nothing here uses
            import sapien  # here: rendering and truth of stored scenes work without the engine

        self._sapien, self._plan, self._random = sapien, plan, random
        size = plan.shape.part_size
        # Engine scene and surface
        contacts = SETTINGS.convex_contacts if len(pieces) == 1 else SETTINGS.pieces_contacts
        sapien.physx.set_shape_config(contact_offset=contacts.offset, rest_offset=0.0)
        sapien.physx.set_body_config(solver_position_iterations=contacts.iterations)
        sapien.physx.set_scene_config(enable_tgs=True, enable_enhanced_determinism=True)
        self._scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        self._scene.set_timestep(SETTINGS.step_s)
        self._material = sapien.physx.PhysxMaterial(plan.friction, plan.friction,
                                                    plan.restitution)
        # The part's pieces; ground and container
        self._pieces = [(piece / size).astype(np.float32) for piece in pieces]
        self._bodies: list[Any] = []
        ground = list(SETTINGS.ground_size)
        self._add_static(sapien.physx.PhysxCollisionShapeBox(ground, self._material), -ground[2])
        for piece in plan.container.collision_pieces():
            self._add_static(self._convex_shape((piece / size).astype(np.float32)), 0.0)

    def _convex_shape(self, corners: np.ndarray) -> Any:
        """The engine's shape of a convex piece from its (n, 3) float32 corners."""
        return self._sapien.physx.PhysxCollisionShapeConvexMesh(
            vertices=corners, scale=np.ones(3, np.float32), material=self._material)

    def _add_static(self, shape: Any, z: float) -> None:
        body = self._sapien.physx.PhysxRigidStaticComponent()
        body.attach(shape)
        self._add_body(body, [0, 0, z], [1, 0, 0, 0])

    def _add_body(self, body: Any, position: Any, quaternion_wxyz: Any) -> None:
        entity = self._sapien.Entity()
        entity.add_component(body)
        entity.set_pose(self._sapien.Pose(position, quaternion_wxyz))
        self._scene.add_entity(entity)

    def pour(self) -> None:
        """Drops the planned number of parts, wave upon wave, each on top of all that is there.

        The column is divided into cells that each have room for the part at any attitude, and a
        part is born anywhere in its cell: no two are born through each other.
        """
        size = self._plan.shape.part_size
        spacing = SETTINGS.spacing * max(np.linalg.norm(piece, axis=1).max()
                                         for piece in self._pieces)
        column = np.maximum(self._plan.column_m / size, spacing)
        grid = np.floor(column / spacing).astype(int)
        cell = column / grid
        cells = int(np.prod(grid))
        wave, rim = cells * SETTINGS.layers, self._plan.container.rim_height_m / size
        for begin in range(0, self._plan.count, wave):
            top = max([rim, *(body.entity_pose.p[2] for body in self._bodies)]) + spacing
            for i in range(min(wave, self._plan.count - begin)):
                place = np.array([i % grid[0], i // grid[0] % grid[1]]) - (grid - 1) / 2
                xy = place * cell + self._random.uniform(-0.5, 0.5, 2) * (cell - spacing)
                quaternion = self._random.normal(size=4)
                self._drop_part([*xy, top + i // cells * spacing],
                                quaternion / np.linalg.norm(quaternion))
            self._run(SETTINGS.wave_s)

    def _drop_part(self, position: list[float], quaternion_wxyz: np.ndarray) -> None:
        body = self._sapien.physx.PhysxRigidDynamicComponent()
        for piece in self._pieces:  # shapes of its own: contacts name bodies by their shapes
            body.attach(self._convex_shape(piece))
        body.linear_damping = body.angular_damping = SETTINGS.falling_damping
        self._add_body(body, position, quaternion_wxyz)
        self._bodies.append(body)

    def shake(self) -> None:
        """Taps the container: in its frame all parts are thrown up and aside together."""
        for _ in range(self._plan.taps):
            aside = self._random.uniform(0, SETTINGS.tap_aside)
            heading = self._random.uniform(0, 2 * np.pi)
            kick = SETTINGS.tap_speed * np.array([aside * np.cos(heading),
                                                  aside * np.sin(heading), 1])
            for body in self._bodies:
                body.linear_velocity = body.linear_velocity + kick.astype(np.float32)
            self._run(SETTINGS.tap_s)

    def settle(self) -> None:
        """Runs until all parts over the container's opening rest.

        Raises:
            SceneError: `unsettled`: some part still moves when the time is up.
        """
        # Until they have landed
        for _ in range(round(SETTINGS.fall_s / SETTINGS.check_s)):
            if np.quantile(self._measure_speeds(), SETTINGS.landed_share) < SETTINGS.landed_speed:
                break
        # Until they rest, with the damping of rolling friction
        for body in self._bodies:
            body.linear_damping = body.angular_damping = SETTINGS.resting_damping
        for check in range(round(SETTINGS.settle_s / SETTINGS.check_s)):
            if check == round(SETTINGS.jolted_s / SETTINGS.check_s):
                self._end_jolts()
            speeds = self._measure_speeds()
            most = np.quantile(speeds, SETTINGS.mostly_rest_share)
            if speeds.max() < SETTINGS.rest_speed and most < SETTINGS.mostly_rest_speed:
                return
        raise SceneError(f"unsettled: {speeds.max():.3f} part sizes/s; expected below "
                         f"{SETTINGS.rest_speed}")

    def _end_jolts(self) -> None:
        """Gives all contacts the friction of things at rest.

        A lower one stands in for the jolts of pouring: with it flat-faced parts creep on for long.
        """
        friction = max(self._plan.friction, SETTINGS.resting_friction)
        self._material.set_static_friction(friction)
        self._material.set_dynamic_friction(friction)

    def _measure_speeds(self) -> np.ndarray:
        """(n,) mean speeds of the parts over the opening while a quarter of a second is run.

        In units/s; of the way made, as the engine's own velocities tremble where contacts are
        many. Without any such part a single 0.
        """
        start = self.poses()[:, :3]
        self._run(SETTINGS.check_s)
        end = self.poses()[:, :3]
        over = self._plan.container.is_over_opening(end * self._plan.shape.part_size)
        speeds = np.linalg.norm(end - start, axis=1)[over] / SETTINGS.check_s
        return speeds if len(speeds) else np.zeros(1)

    def _run(self, seconds: float) -> None:
        for _ in range(round(seconds / SETTINGS.step_s)):
            self._scene.step()

    def deepest_overlap(self) -> float:
        """Deepest overlap of any two bodies, in part sizes."""
        return max((-point.separation for contact in self._scene.physx_system.get_contacts()
                    for point in contact.points), default=0.0)

    def poses(self) -> np.ndarray:
        """(n, 7) float64 position in part sizes and quaternion (x, y, z, w) of each part."""
        return np.array([[*body.entity_pose.p, *np.roll(body.entity_pose.q, -1)]
                         for body in self._bodies], float).reshape(-1, 7)
