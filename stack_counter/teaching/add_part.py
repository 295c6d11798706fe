# SPDX-License-Identifier: Apache-2.0
"""From a part's mesh to what is known of its gamma: `stack-counter part add`."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from stack_counter.config import Config
from stack_counter.errors import PartError
from stack_counter.occupancy.known_form import form_of_mesh
from stack_counter.occupancy.weights_file import save_tuning, tuned_name
from stack_counter.parts.calibration import history_at_volume
from stack_counter.parts.catalogue import Part, find_part, save_part
from stack_counter.parts.part_models import PartModels
from stack_counter.sim import FRICTION, PieceForm, ShapeError, rough_form, shape_from_mesh
from stack_counter.teaching.model_fit import fit_model
from stack_counter.teaching.part_mesh import PartMesh
from stack_counter.teaching.simulated_piles import (
    Pile,
    PileRequest,
    make_rig_container,
    simulate_piles,
)
from stack_counter.teaching.tuning import Tuning, tune


@dataclass(frozen=True)
class NewPart:
    """What a part is to be added by.

    Attributes:
        name: of the part in the catalogue.
        mesh_path: its CAD file, of which a copy is stored beside the catalogue.
        unit: of the file's numbers.
        density: of the material, kg/m3; None: as it is known already.
        friction: least and most, of parts on each other; None: as it is known already.
        piles: number of piles to simulate; 0: v and the form of the mesh must do.
        workers: number of processes.
        tune: whether the network's last layers are adapted to the piles, where that is better.
        force: whether a part of another v is replaced, and its counted bins forgotten.
    """

    name: str
    mesh_path: Path
    unit: str = "mm"
    density: float | None = None
    friction: tuple[float, float] | None = None
    piles: int = 64
    workers: int = 1
    tune: bool = False
    force: bool = False


@dataclass(frozen=True, eq=False)
class PileKnowledge:
    """What a part's piles have taught.

    Attributes:
        models: of gamma.
        tuning: of the network, where it was tried.
        tuned: file of the last layers; None where they are not tuned.
        rough_form: form of the convex pieces that it collided with, where they miss its own.
    """

    models: PartModels
    tuning: Tuning | None
    tuned: Path | None
    rough_form: PieceForm | None


@dataclass(frozen=True, eq=False)
class AddedPart:
    """A part as it was added: its entry, and what its piles taught; None where none were made."""

    part: Part
    learnt: PileKnowledge | None


def add_part(request: NewPart, mesh: PartMesh, config: Config, catalogue: Path,
             on_pile: Callable[[], None]) -> AddedPart:
    """Measures a part's mesh, simulates piles of it, and writes it into a catalogue.

    Args:
        request: what is wanted.
        mesh: of the part, read from `request.mesh_path`.
        config: settings; they describe the rig.
        catalogue: file; the part's own files go into `parts` beside it.
        on_pile: called after each pile, for progress.

    Raises:
        ConfigError: the catalogue is malformed, or the settings name an unknown container.
        PartError: the part is there with another v, does not pile up, or too few of its piles
            gave a scan.
    """
    # Refuse another v, then simulate.
    old = find_part(request.name, catalogue)
    history_at_volume(old, mesh.unit_volume, request.force)
    low, high = sorted(request.friction or (old.friction if old and old.friction else FRICTION))
    order = make_pile_request(mesh.vertices, mesh.faces, config, (low, high), request.tune)
    folder = catalogue.parent / "parts"
    folder.mkdir(parents=True, exist_ok=True)
    learnt = _learn_from_piles(request, order, folder, on_pile) if request.piles else None
    # Store the models, the mesh and the entry; bins may have been counted meanwhile.
    prior = folder / f"{request.name}.json"
    if learnt is not None:
        learnt.models.write(prior)
    stored = _store_mesh(request, folder)
    old = find_part(request.name, catalogue)
    density = request.density if request.density is not None else old.density if old else 0.0
    form = form_of_mesh(mesh.vertices, mesh.faces)
    # Without piles those of before stay, if they are of the same part.
    same = old is not None and math.isclose(old.unit_volume, mesh.unit_volume, rel_tol=1e-3)
    before = old if same else None
    part = Part(mesh.unit_volume, request.name, 0.0, stored, density, (low, high),
                prior if learnt else before.gamma_prior if before else None,
                learnt.tuned if learnt else before.tuned if before else None,
                f"{date.today()} from {request.mesh_path.name}, unit {request.unit}",
                history_at_volume(old, mesh.unit_volume, request.force),
                outer_size_m=form.outer_size_m, mesh_measures=form.mesh,
                piece_weight=old.piece_weight if old and not request.force else None)
    save_part(part, catalogue)
    return AddedPart(part, learnt)


def _learn_from_piles(request: NewPart, order: PileRequest, folder: Path,
                      on_pile: Callable[[], None]) -> PileKnowledge:
    """Simulates piles, fits models, and tunes the network if that is better on piles left out."""
    piles = simulate_part_piles(order, request.piles, request.workers, on_pile)
    models = fit_part_models(order, piles)
    tuning, tuned = tune(piles) if request.tune else None, None
    if tuning is not None and tuning.better:
        tuned = folder / f"{request.name}.safetensors"
        save_tuning(tuned, tuning.weight, tuning.bias, models.estimator)
        name = tuned_name(models.estimator, tuning.weight, tuning.bias)
        models = fit_part_models(order, tuning.piles, name)
    return PileKnowledge(models, tuning, tuned, rough_form(order.shape))


def _store_mesh(request: NewPart, folder: Path) -> Path:
    stored = folder / f"{request.name}{request.mesh_path.suffix.lower()}"
    if stored.resolve() != request.mesh_path.resolve():
        shutil.copyfile(request.mesh_path, stored)
    return stored


def make_pile_request(vertices: np.ndarray, faces: np.ndarray, config: Config,
                      friction: tuple[float, float] = FRICTION, tune: bool = False
                      ) -> PileRequest:
    """Describes what to simulate for a part on the rig of the settings.

    Args:
        vertices: (n, 3) float64, metres, in the part's own frame.
        faces: (m, 3) int32, counter-clockwise from outside.
        config: settings.
        friction: least and most, of parts on each other.
        tune: whether the network's last layers are to be adapted to the piles.

    Raises:
        ConfigError: the settings name a container that is not known.
        PartError: the mesh is no solid that the simulator can use, or there is no network to
            tune.
    """
    try:
        shape = shape_from_mesh(vertices, faces, "part")
    except ShapeError as error:
        raise PartError(str(error)) from error
    if tune and (config.counter.estimator != "network" or config.counter.encoder_weights):
        raise PartError(f"the estimator is '{config.counter.estimator}' with encoder_weights "
                        f"'{config.counter.encoder_weights}'; expected 'network' without, to tune")
    return PileRequest(shape, make_rig_container(config.reconstructor), friction, config.counter,
                       keep_last_layer_input=tune)


def simulate_part_piles(request: PileRequest, count: int, workers: int,
                        on_pile: Callable[[], None]) -> list[Pile]:
    """Simulates piles of a part; `on_pile` is called after each.

    Raises:
        PartError: the part does not pile up, or its mesh is no solid.
    """
    piles = []
    try:
        for pile in simulate_piles(request, count, workers):
            piles.append(pile)
            on_pile()
    except ShapeError as error:
        raise PartError(str(error)) from error
    return piles


def fit_part_models(request: PileRequest, piles: list[Pile], estimator: str = "") -> PartModels:
    """Fits a part's models of gamma to its piles.

    Args:
        request: by which the piles were simulated.
        piles: of the part.
        estimator: name of the estimator that read the piles, where it is another than the
            request's.

    Raises:
        PartError: too few of the piles gave a scan.
    """
    low, high = request.friction
    where = "containers of all widths" if request.container is None else \
        f"{request.container.kind} of " + " x ".join(
            f"{1000 * s:.0f}" for s in request.container.inner_size_m) + " mm"
    return PartModels(
        estimator or request.load_estimator().name,
        fit_model([p.arc for p in piles if p.arc]),
        fit_model([p.above for p in piles if p.above], "one side"),
        f"{len(piles)} simulated piles, {where}, friction {low:g} to {high:g}")
