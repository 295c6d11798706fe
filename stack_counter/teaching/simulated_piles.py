"""Piles of one part as a rig may see them, simulated, recorded with noise and reconstructed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context

import numpy as np

from stack_counter import geometry
from stack_counter.config import CounterConfig, ReconstructorConfig
from stack_counter.container.catalogue import configured_container
from stack_counter.errors import PartError, ScanError, StackCounterError
from stack_counter.occupancy.baselines import OccupancyEstimator, make_estimator
from stack_counter.occupancy.network import NetworkEstimator
from stack_counter.parts.gamma_model import Reading, fill_size
from stack_counter.sim import (
    ContainerShape,
    Scene,
    SceneError,
    Shape,
    draw_deep_container,
    draw_plan_in_container,
    max_simulated_parts,
    reconstruct,
    reconstruct_from_above,
    simulate_pile,
)
from stack_counter.types import StackVolume

_SIZES = 1.25  # by which the rig's container is taken larger or smaller, for its slope
_TRIES = 12
_SEED = 0xADD


@dataclass(frozen=True)
class PileScan:
    """One simulated pile as one kind of scan shows it: what is read, the relative standard
    deviation of V, the friction it was made with, and, if the network shall be tuned, what its
    last layers read, (members, h)."""

    reading: Reading
    volume_std: float
    friction: float
    hidden: np.ndarray | None = None


@dataclass(frozen=True)
class Pile:
    """A pile seen in an arc of views, and in one from above; None where that scan is refused."""

    arc: PileScan | None
    above: PileScan | None


@dataclass(frozen=True)
class PileRequest:
    """What to simulate.

    Attributes:
        shape: the part.
        container: of the rig; None for a spread of them.
        friction: least and most.
        estimator: settings of what says gamma.
        tune: keep what the network's last layers read.
        seed: of everything.
    """

    shape: Shape
    container: ContainerShape | None
    friction: tuple[float, float]
    estimator: CounterConfig
    tune: bool = False
    seed: int = _SEED


def simulate_piles(order: PileRequest, count: int, workers: int) -> Iterator[Pile]:
    """That many piles, as they get done.

    Raises:
        PartError: the part makes no pile: no decomposition, or it does not come to rest.
    """
    if workers == 1:
        for index in range(count):
            yield make_pile(order, index)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(make_pile, order, index) for index in range(count)]
        try:
            for job in as_completed(jobs):
                yield job.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def make_pile(order: PileRequest, index: int) -> Pile:
    """Pile `index`: depends on the order and the index alone.

    Raises:
        PartError: as `simulate_piles`.
    """
    why = ""
    for attempt in range(_TRIES):
        random = np.random.default_rng([order.seed, index, attempt])
        try:
            scene = _dropped(order, random, index)
            break
        except SceneError as error:
            why = str(error)
    else:
        raise PartError(f"the part does not pile up: {why} ({_TRIES} tries)")
    estimator = _estimator(order.estimator)
    return Pile(*(_seen(scene, how, estimator, order.tune)
                  for how in (reconstruct, reconstruct_from_above)))


def _dropped(order: PileRequest, random: np.random.Generator, index: int) -> Scene:
    most = max_simulated_parts(order.shape)
    container = draw_deep_container(random, order.shape, most) if order.container is None \
        else scaled(order.container, float(np.exp(random.uniform(-1, 1) * np.log(_SIZES))))
    return simulate_pile(
        draw_plan_in_container(random, order.shape, container, order.friction, most),
        random,
        order.seed,
        index,
    )


@cache
def _estimator(config: CounterConfig) -> OccupancyEstimator:
    return make_estimator(config)


def _seen(scene: Scene, how: Callable[[Scene], StackVolume], estimator: OccupancyEstimator,
          tune: bool) -> PileScan | None:
    v = scene.truth.unit_volume
    try:
        volume = how(scene)
        return PileScan(
            counted_reading(volume, v, estimator, scene.truth.count),
            volume.stack_volume_std / volume.stack_volume,
            scene.friction,
            estimator.hidden(volume, v)
            if tune and isinstance(estimator, NetworkEstimator)
            else None,
        )
    except StackCounterError:
        return None


def counted_reading(
    volume: StackVolume, unit_volume: float, estimator: OccupancyEstimator, count: int
) -> Reading:
    """A counted scan.

    Raises:
        ScanError: it shows nothing.
    """
    if not volume.stack_volume > 0:
        raise ScanError(f"V of {count} parts is {volume.stack_volume} m3; expected some")
    said = float(np.log(estimator.estimate(volume, unit_volume).gamma))
    return Reading(*fill_size(volume, unit_volume), said,
                   float(np.log(count * unit_volume / volume.stack_volume)))


def rig_container(config: ReconstructorConfig) -> ContainerShape | None:
    """The container that the settings describe, as the simulator makes it; None if they name none.

    Raises:
        ConfigError: as `configured_container`.
    """
    taught = configured_container(config)
    if taught is None:
        kind, size = config.container_kind, config.container_inner_size_m
        kind = "box" if kind == "auto" else kind
        if kind not in ("box", "round", "free") or not all(size):
            return None
        wall = config.container_wall_m or 0.003
        x, y, depth = size
        return _container(kind, (x, y, depth), wall, config.container_floor_m or wall, 0.0)
    rim, depth = taught.wall_shape.ring(0.0, taught.wall_m), taught.rim_m - taught.floor_m
    foot = taught.wall_shape.ring(depth, taught.wall_m)
    x, y = np.ptp(rim, axis=0)
    lean = float(np.clip(np.ptp(rim, axis=0) - np.ptp(foot, axis=0), 0, None).mean()) / 2 / depth
    return _container(taught.wall_shape.kind, (x, y, depth), max(taught.wall_m, 1e-3),
                      max(taught.floor_m, 1e-3), float(np.arctan(lean)))


def scaled(container: ContainerShape, factor: float) -> ContainerShape:
    """The container, all sizes times a factor."""
    x, y, depth = container.inner_size_m
    return ContainerShape(container.kind, container.T_world_container,
                          (x * factor, y * factor, depth * factor), container.wall_thickness_m,
                          container.floor_thickness_m, container.draft_rad, container.seed)


def _container(kind: str, size: tuple[float, float, float], wall: float, floor: float,
               draft: float) -> ContainerShape:
    name = {"box": "bin", "round": "cylinder", "free": "bag"}[kind]
    return ContainerShape(name, geometry.pose(np.eye(3), np.zeros(3)), size, wall, floor, draft)
