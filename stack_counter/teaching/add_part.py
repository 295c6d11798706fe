"""From a part's mesh to what is known of its gamma: `stack-counter part add`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stack_counter.config import Config
from stack_counter.errors import PartError
from stack_counter.occupancy.baselines import make_estimator
from stack_counter.parts.gamma_model import PartModels
from stack_counter.sim import FRICTION, ShapeError, shape_from_mesh
from stack_counter.teaching.model_fit import fit_model
from stack_counter.teaching.simulated_piles import Pile, PileRequest, rig_container, simulate_piles


def make_order(vertices: np.ndarray, faces: np.ndarray, config: Config,
               friction: tuple[float, float] = FRICTION, tune: bool = False) -> PileRequest:
    """What to simulate for a part on the rig that the settings describe.

    Args:
        vertices: (n, 3) metres; `faces` (m, 3), counter-clockwise from outside.
        config: settings.
        friction: least and most, of parts on each other.
        tune: the network's last layers shall be adapted to the piles.

    Raises:
        ConfigError: the settings name a container that is not known.
        PartError: the mesh is no solid that the simulator can use; no network to tune.
    """
    try:
        shape = shape_from_mesh(vertices, faces, "part")
    except ShapeError as error:
        raise PartError(str(error)) from error
    if tune and (config.counter.estimator != "network" or config.counter.encoder_weights):
        raise PartError(f"the estimator is '{config.counter.estimator}' with encoder_weights "
                        f"'{config.counter.encoder_weights}'; expected 'network' without, to tune")
    return PileRequest(shape, rig_container(config.reconstructor), friction, config.counter, tune)


def simulate_part(order: PileRequest, piles: int, workers: int, on_pile: Callable[[], None]
                  ) -> list[Pile]:
    """The piles; `on_pile` is called after each.

    Raises:
        PartError: the part does not pile up.
    """
    made = []
    try:
        for pile in simulate_piles(order, piles, workers):
            made.append(pile)
            on_pile()
    except ShapeError as error:
        raise PartError(f"{error}; a part of many small details: expected a mesh without threads "
                        "and lettering") from error
    return made


def models_of(order: PileRequest, piles: list[Pile], estimator: str = "") -> PartModels:
    """What the piles say; `estimator`: its name, where it is another than the order's.

    Raises:
        PartError: too few of them gave a scan.
    """
    low, high = order.friction
    where = "containers of all widths" if order.container is None else \
        f"{order.container.kind} of " + " x ".join(
            f"{1000 * s:.0f}" for s in order.container.inner_size_m) + " mm"
    return PartModels(
        estimator or make_estimator(order.estimator).name,
        fit_model([p.arc for p in piles if p.arc]),
        fit_model([p.above for p in piles if p.above], "one side"),
        f"{len(piles)} simulated piles, {where}, friction {low:g} to {high:g}")
