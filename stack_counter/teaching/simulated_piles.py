# SPDX-License-Identifier: Apache-2.0
"""Piles of one part as a rig may see them, simulated, recorded with noise and reconstructed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from stack_counter import geometry
from stack_counter.config import CounterConfig, ReconstructorConfig
from stack_counter.container.catalogue import configured_container
from stack_counter.errors import PartError, ScanError, StackCounterError
from stack_counter.occupancy import OccupancyEstimator, make_estimator
from stack_counter.occupancy.known_form import form_of_mesh
from stack_counter.occupancy.network import NetworkEstimator
from stack_counter.parts.gamma_model import Reading, fill_size
from stack_counter.sim import (
    PART_PILE_PIECES,
    ContainerShape,
    Scene,
    SceneError,
    Shape,
    convex_pieces,
    draw_deep_container,
    draw_plan_in_container,
    max_simulated_parts,
    reconstruct,
    reconstruct_from_above,
    simulate_pile,
)
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.types import StackVolume


@dataclass(frozen=True)
class SimulatedPilesSettings:
    """How a rig's container is varied and made; chosen.

    Attributes:
        size_factor: largest factor by which the container is taken larger or smaller, so that the
            fit has a slope over its width.
        max_tries: plans drawn for a pile before it is left out.
        max_failed: piles left out from which a part is refused that has more of them than others.
        seed: seed of all piles, if none is given.
        default_wall_m: thickness of a wall that the configuration leaves open.
        min_wall_m: least thickness of a taught container's wall and floor.
    """

    size_factor: float = 1.25
    max_tries: int = 12
    max_failed: int = 4
    seed: int = 0xADD
    default_wall_m: float = 0.003
    min_wall_m: float = 1e-3


SETTINGS = SimulatedPilesSettings()
# The simulator's kind of a container that the run time calls so.
SIMULATED_KIND = {"box": "bin", "round": "cylinder", "free": "bag"}


@dataclass(frozen=True)
class PileScan:
    """One simulated pile as one kind of scan shows it.

    Attributes:
        reading: fill, and log gamma as estimated and as counted.
        volume_std: relative standard deviation of V.
        friction: the friction that it was made with.
        last_layer_input: (members, h) inputs of the network's last layers; None if the request
            does not keep them.
    """

    reading: Reading
    volume_std: float
    friction: float
    last_layer_input: np.ndarray | None = None


@dataclass(frozen=True)
class Pile:
    """A pile seen in an arc of views, and in one from above.

    Attributes:
        arc, above: what each shows; None where that scan is refused, or no try came to rest.
        failed_tries: what was wrong with the tries before: a few words, a colon, the values.
    """

    arc: PileScan | None
    above: PileScan | None
    failed_tries: tuple[str, ...] = ()

    @property
    def rests(self) -> bool:
        """Whether a try came to rest."""
        return len(self.failed_tries) < SETTINGS.max_tries

    def count_failed_tries(self) -> Counter[str]:
        """Number of the tries before by what was wrong, in a few words."""
        return Counter(why.split(":")[0] for why in self.failed_tries)


@dataclass(frozen=True)
class PileRequest:
    """What to simulate.

    Attributes:
        shape: the part.
        container: the rig's container; None for a spread of containers.
        friction: least and most.
        estimator: settings of the gamma estimator.
        keep_last_layer_input: keep what the network's last layers read.
        scanned: scan the piles too, which takes most of the time.
        seed: seed of everything.
    """

    shape: Shape
    container: ContainerShape | None
    friction: tuple[float, float]
    estimator: CounterConfig
    keep_last_layer_input: bool = False
    scanned: bool = True
    seed: int = SETTINGS.seed

    def load_estimator(self) -> OccupancyEstimator:
        """The gamma estimator as it knows the part's mesh."""
        form = form_of_mesh(self.shape.vertices, self.shape.faces)
        return _load_estimator(self.estimator).knowing(form)


def simulate_piles(request: PileRequest, count: int, workers: int) -> Iterator[Pile]:
    """Simulates that many piles and gives them in their order, whichever gets done first.

    Raises:
        PartError: most piles do not come to rest.
        ShapeError: the mesh is no solid.
    """
    convex_pieces(request.shape)  # once: workers find them in the cache
    make = partial(make_pile, request)
    if workers == 1:
        yield from _refuse_restless(map(make, range(count)))
        return
    with worker_pool(workers) as pool:
        # Not by `map`: interrupted, it cancels futures that the pool then stumbles over.
        jobs = [pool.submit(make, index) for index in range(count)]
        yield from _refuse_restless(job.result() for job in jobs)


def _refuse_restless(piles: Iterable[Pile]) -> Iterator[Pile]:
    """Gives the piles on as long as most of them come to rest."""
    failed = 0
    for done, pile in enumerate(piles, 1):
        failed += not pile.rests
        if failed >= SETTINGS.max_failed and 2 * failed > done:
            why = ", ".join(f"{n} x {reason}"
                            for reason, n in pile.count_failed_tries().most_common())
            raise PartError(f"the part does not pile up: {failed} of {done} piles failed "
                            f"{SETTINGS.max_tries} times each ({why}), the last by "
                            f"{pile.failed_tries[-1]}; check --unit, the configured container's "
                            "size, and the mesh: one with thicker walls or rounder may rest")
        yield pile


def make_pile(request: PileRequest, index: int) -> Pile:
    """Makes pile `index`, which depends on the request and the index alone.

    Raises:
        ShapeError: the mesh is no solid.
    """
    failed_tries: list[str] = []
    for attempt in range(SETTINGS.max_tries):
        random = np.random.default_rng([request.seed, index, attempt])
        try:
            scene = _simulate_scene(request, random, index)
            break
        except SceneError as error:
            failed_tries.append(str(error))
    else:
        return Pile(None, None, tuple(failed_tries))
    if not request.scanned:
        return Pile(None, None, tuple(failed_tries))
    estimator = request.load_estimator()
    arc, above = (_scan_pile(scene, scan, estimator, request.keep_last_layer_input)
                  for scan in (reconstruct, reconstruct_from_above))
    return Pile(arc, above, tuple(failed_tries))


def _simulate_scene(request: PileRequest, random: np.random.Generator, index: int) -> Scene:
    """One try of a pile, in a container of any size or in one about the rig's."""
    max_parts = max_simulated_parts(request.shape, PART_PILE_PIECES)
    if request.container is None:
        container = draw_deep_container(random, request.shape, max_parts)
    else:
        log_factor = random.uniform(-1, 1) * np.log(SETTINGS.size_factor)
        container = scale_container(request.container, float(np.exp(log_factor)))
    plan = draw_plan_in_container(random, request.shape, container, request.friction, max_parts)
    return simulate_pile(plan, random, request.seed, index)


@cache
def _load_estimator(config: CounterConfig) -> OccupancyEstimator:
    return make_estimator(config)


def _scan_pile(scene: Scene, scan: Callable[[Scene], StackVolume], estimator: OccupancyEstimator,
               keep_last_layer_input: bool) -> PileScan | None:
    """A pile as one kind of scan shows it; None if the scan is refused."""
    unit_volume = scene.truth.unit_volume
    try:
        volume = scan(scene)
        return PileScan(
            counted_reading(volume, unit_volume, estimator, scene.truth.count),
            volume.stack_volume_std / volume.stack_volume, scene.friction,
            estimator.last_layer_input(volume, unit_volume)
            if keep_last_layer_input and isinstance(estimator, NetworkEstimator) else None)
    except StackCounterError:
        return None


def counted_reading(volume: StackVolume, unit_volume: float, estimator: OccupancyEstimator,
                    count: int) -> Reading:
    """The reading of a scan whose count is known.

    Raises:
        ScanError: it shows nothing.
    """
    if not volume.stack_volume > 0:
        raise ScanError(f"V of {count} parts is {volume.stack_volume} m3; expected some")
    estimated = float(np.log(estimator.estimate(volume, unit_volume).gamma))
    counted = float(np.log(count * unit_volume / volume.stack_volume))
    return Reading(*fill_size(volume, unit_volume), estimated, counted)


def make_rig_container(config: ReconstructorConfig) -> ContainerShape | None:
    """The container that the settings describe, as the simulator makes it; None if they name none.

    Raises:
        ConfigError: the settings name a taught container that is not in the catalogue.
    """
    taught = configured_container(config)
    # Configured by its sizes
    if taught is None:
        kind, size = config.container_kind, config.container_inner_size_m
        kind = "box" if kind == "auto" else kind
        if kind not in SIMULATED_KIND or not all(size):
            return None
        wall_m = config.container_wall_m or SETTINGS.default_wall_m
        x, y, depth = size
        floor_size = config.container_floor_size_m if all(config.container_floor_size_m) \
            else (x, y)
        slope = max(x - floor_size[0] + y - floor_size[1], 0.0) / 4 / depth
        return _make_container(kind, (x, y, depth), wall_m, config.container_floor_m or wall_m,
                               draft_rad=float(np.arctan(slope)))
    # Taught: inner size at the rim, and the draft by how much smaller it is at the floor
    depth = taught.rim_m - taught.floor_m
    rim = np.ptp(taught.wall_shape.ring(0.0, taught.wall_m), axis=0)
    foot = np.ptp(taught.wall_shape.ring(depth, taught.wall_m), axis=0)
    slope = float(np.clip(rim - foot, 0, None).mean()) / 2 / depth
    return _make_container(
        taught.wall_shape.kind, (rim[0], rim[1], depth), max(taught.wall_m, SETTINGS.min_wall_m),
        max(taught.floor_m, SETTINGS.min_wall_m), draft_rad=float(np.arctan(slope)))


def scale_container(container: ContainerShape, factor: float) -> ContainerShape:
    """The container with its inner size times a factor."""
    x, y, depth = container.inner_size_m
    return replace(container, inner_size_m=(x * factor, y * factor, depth * factor))


def _make_container(kind: str, size_m: tuple[float, float, float], wall_m: float, floor_m: float,
                    draft_rad: float) -> ContainerShape:
    """A container at the world's origin; `kind` as the run time calls it."""
    return ContainerShape(SIMULATED_KIND[kind], geometry.pose(np.eye(3), np.zeros(3)), size_m,
                          wall_m, floor_m, draft_rad)
