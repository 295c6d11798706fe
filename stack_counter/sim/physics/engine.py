"""Drops parts into a container or on a heap with PhysX 5 (sapien), until they rest.

Lengths are scaled so that a part is one unit: the engine's tolerances are made for that size.
Every pile has an engine scene of its own, so that it does not depend on what was made before it.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.scenes.scene import SceneError

_STEP_S = 1 / 60
_LAYERS = 3  # of parts a wave
_WAVE_S = 0.4  # simulated time between two waves
_CHECK_S, _FALL_S, _SETTLE_S = 0.25, 8.0, 6.0  # between two looks at the speeds; longest times
# until parts have landed, and until they rest
_LANDED = 0.5  # units/s of 98% of the parts when the fall is over
_STILL, _NEARLY_STILL = 0.1, 0.05  # units/s of the fastest part, and of 95% of them, at rest
_TAP_S, _TAP_SPEED = 0.4, 1.2  # between two taps on the container; units/s that a tap gives
_SPACING = 2.02  # between dropped parts, in their largest radius
_ITERATIONS = 8  # of the solver; with 16 piles rest no sooner, and 8 keep the overlap's limit


class PileSimulation:
    """One physics scene, lengths in part sizes, container frame."""

    def __init__(self, plan: PilePlan, pieces: list[np.ndarray], random: np.random.Generator):
        """An empty container.

        Args:
            pieces: corners (n, 3) of the part's convex pieces, metres.
            random: draws attitudes and places.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the graphics driver, which nothing here uses
            import sapien  # here: rendering and truth of stored scenes work without the engine

        self._sapien, self._plan, self._random = sapien, plan, random
        size = plan.shape.part_size
        sapien.physx.set_shape_config(contact_offset=0.04, rest_offset=0.0)
        sapien.physx.set_body_config(solver_position_iterations=_ITERATIONS)
        sapien.physx.set_scene_config(enable_tgs=True, enable_enhanced_determinism=True)
        self._scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        self._scene.set_timestep(_STEP_S)
        self._material = sapien.physx.PhysxMaterial(plan.friction, plan.friction,
                                                    plan.restitution)
        self._pieces = [(piece / size).astype(np.float32) for piece in pieces]
        self._bodies: list[Any] = []
        self._fixed(sapien.physx.PhysxCollisionShapeBox([60, 60, 1], self._material), -1.0)
        for piece in plan.container.collision_pieces():
            self._fixed(self._hull((piece / size).astype(np.float32)), 0.0)

    def _hull(self, corners: np.ndarray) -> Any:
        return self._sapien.physx.PhysxCollisionShapeConvexMesh(
            vertices=corners, scale=np.ones(3, np.float32), material=self._material)

    def _fixed(self, shape: Any, z: float) -> None:
        body = self._sapien.physx.PhysxRigidStaticComponent()
        body.attach(shape)
        self._place(body, [0, 0, z], [1, 0, 0, 0])

    def _place(self, body: Any, position: Any, quaternion_wxyz: Any) -> None:
        entity = self._sapien.Entity()
        entity.add_component(body)
        entity.set_pose(self._sapien.Pose(position, quaternion_wxyz))
        self._scene.add_entity(entity)

    def pour(self) -> None:
        """Drops the planned number of parts, wave upon wave, each on top of all that is there."""
        spacing = _SPACING * max(np.linalg.norm(piece, axis=1).max() for piece in self._pieces)
        room = np.maximum(self._plan.column_m / self._plan.shape.part_size - spacing, 0)
        grid = np.floor(room / spacing).astype(int) + 1
        cells = int(np.prod(grid))
        wave, rim = cells * _LAYERS, self._plan.container.rim_height_m / self._plan.shape.part_size
        for begin in range(0, self._plan.count, wave):
            top = max([rim, *(body.entity_pose.p[2] for body in self._bodies)]) + spacing
            loose = np.maximum(room - (grid - 1) * spacing, 0) / 2
            for i in range(min(wave, self._plan.count - begin)):
                cell = np.array([i % grid[0], i // grid[0] % grid[1]])
                xy = (cell - (grid - 1) / 2) * spacing + self._random.uniform(-1, 1, 2) * loose
                q = self._random.normal(size=4)
                self._drop([*xy, top + i // cells * spacing], q / np.linalg.norm(q))
            self._run(_WAVE_S)

    def _drop(self, position: list[float], quaternion_wxyz: np.ndarray) -> None:
        body = self._sapien.physx.PhysxRigidDynamicComponent()
        for piece in self._pieces:  # shapes of its own: contacts name bodies by their shapes
            body.attach(self._hull(piece))
        body.linear_damping = body.angular_damping = 0.5
        self._place(body, position, quaternion_wxyz)
        self._bodies.append(body)

    def shake(self) -> None:
        """Taps the container: in its frame all parts are thrown up and aside together."""
        for _ in range(self._plan.taps):
            aside, turn = self._random.uniform(0, 0.6), self._random.uniform(0, 2 * np.pi)
            kick = _TAP_SPEED * np.array([aside * np.cos(turn), aside * np.sin(turn), 1])
            for body in self._bodies:
                body.linear_velocity = body.linear_velocity + kick.astype(np.float32)
            self._run(_TAP_S)

    def settle(self) -> None:
        """Runs until all parts rest.

        Raises:
            SceneError: `unsettled`.
        """
        for _ in range(round(_FALL_S / _CHECK_S)):
            if np.quantile(self._speeds(), 0.98) < _LANDED:
                break
        for body in self._bodies:  # what still rolls has rolling friction in a real cell
            body.linear_damping = body.angular_damping = 5.0
        for _ in range(round(_SETTLE_S / _CHECK_S)):
            speeds = self._speeds()
            if speeds.max() < _STILL and np.quantile(speeds, 0.95) < _NEARLY_STILL:
                return
        raise SceneError(f"unsettled: {speeds.max():.3f} part sizes/s; expected below {_STILL}")

    def _speeds(self) -> np.ndarray:
        """(n,) mean speeds while a quarter of a second is run, units/s: of the way made, as the
        engine's own velocities tremble where contacts are many."""
        before = self.poses()[:, :3]
        self._run(_CHECK_S)
        return np.linalg.norm(self.poses()[:, :3] - before, axis=1) / _CHECK_S

    def _run(self, seconds: float) -> None:
        for _ in range(round(seconds / _STEP_S)):
            self._scene.step()

    def deepest_overlap(self) -> float:
        """Deepest overlap of any two bodies, in part sizes."""
        return max((-point.separation for contact in self._scene.physx_system.get_contacts()
                    for point in contact.points), default=0.0)

    def poses(self) -> np.ndarray:
        """(n, 7) float64 position in part sizes and quaternion (x, y, z, w) of each part."""
        return np.array([[*b.entity_pose.p, *np.roll(b.entity_pose.q, -1)]
                         for b in self._bodies], float).reshape(-1, 7)
