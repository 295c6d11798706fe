# SPDX-License-Identifier: Apache-2.0
"""What knowing the part brings: v only, its CAD file, one counted bin, both.

    stack-counter evaluate parts --set unseen-rigs --workers 2

Each rig of the set is one part in one container with one friction, which nothing is told of. Its
CAD row is `part add` with all defaults or, with `--container`, with the rig's container in the
settings. Every scan is counted by each of the others of its rig in turn; the errors of those are
averaged.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass, replace

from typing_extensions import override

from stack_counter.config import Config, CounterConfig, ReconstructorConfig
from stack_counter.errors import StackCounterError
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.part_table import (
    PartCount,
    Rig,
    format_sensitivity,
    format_table,
)
from stack_counter.eval.common.sets import find_set_folder
from stack_counter.occupancy import OccupancyEstimator, make_estimator
from stack_counter.occupancy.known_form import form_of_mesh
from stack_counter.parts.calibration import calibrate
from stack_counter.parts.catalogue import Part
from stack_counter.parts.gamma_model import Reading
from stack_counter.parts.part_models import PartModels
from stack_counter.sim import RECONSTRUCTED_KIND, SCENES_PER_RIG, Scene, read_scenes, reconstruct
from stack_counter.stack_count import count_stack
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.teaching import (
    Pile,
    PileScan,
    fit_part_models,
    make_pile_request,
    simulate_part_piles,
)
from stack_counter.types import KnownForm, OccupancyEstimate, StackVolume

_SEED = 0


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    # Models from CAD, and the volumes of all scans
    rigs = group_by_rig(list(read_scenes(find_set_folder(options.set))))[:options.rigs]
    options.cache.mkdir(parents=True, exist_ok=True)
    models = {rig.number: _learn_models(rig, options)
              for rig in progress(rigs, "part add", "rigs")}
    scenes = [scene for rig in rigs for scene in rig.scenes]
    volumes = dict(zip((s.index for s in scenes), progress(
        map_tasks(_measure_volume, scenes, Workers.of(options)), "volumes", "scans",
        len(scenes))))
    # Counts by all that may be known of the part
    estimator, counts = CachedEstimator(make_estimator(CounterConfig())), []
    for rig in progress(rigs, "counts", "rigs"):
        scans = [(s, v) for s in rig.scenes if (v := volumes[s.index]) is not None]
        counts += count_all_ways(rig, scans, models[rig.number], estimator, options.confidence)
    print(format_table(rigs, counts, sum(v is None for v in volumes.values())))
    print(format_sensitivity(list(models.values())))
    if options.json:
        write_figures(options.json, counts)
    return 0


def group_by_rig(scenes: list[Scene]) -> list[Rig]:
    """The scenes by rig; those of another part than the first are left out."""
    rigs: dict[int, Rig] = {}
    for s in scenes:
        number = s.index // SCENES_PER_RIG
        rig = rigs.setdefault(number, Rig(number, s.shape.family, s.shape.seed, s.container.kind,
                                          s.friction, []))
        if (s.shape.family, s.shape.seed) == (rig.family, rig.seed):
            rig.scenes.append(s)
    return list(rigs.values())


class CachedEstimator(OccupancyEstimator):
    """An estimator that computes the gamma of a scan once."""

    def __init__(self, estimator: OccupancyEstimator):
        """Wraps an estimator."""
        self.name, self._estimator = estimator.name, estimator
        self._estimates: dict[tuple[int, float], OccupancyEstimate] = {}
        self._knowing: dict[KnownForm, CachedEstimator] = {}

    @override
    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        key = (id(volume), unit_volume)  # volumes must live as long as this does
        if key not in self._estimates:
            self._estimates[key] = self._estimator.estimate(volume, unit_volume)
        return self._estimates[key]

    @override
    def knowing(self, form: KnownForm) -> CachedEstimator:
        if form not in self._knowing:
            self._knowing[form] = CachedEstimator(self._estimator.knowing(form))
        return self._knowing[form]


def _learn_models(rig: Rig, options: argparse.Namespace) -> PartModels:
    """The models that `part add` learns, from piles kept in the cache."""
    # What to simulate
    shape, container = rig.scenes[0].shape, rig.scenes[0].container
    config = Config(reconstructor=ReconstructorConfig(
        container_kind=RECONSTRUCTED_KIND[container.kind],
        container_inner_size_m=container.inner_size_m)) if options.container else Config()
    request = make_pile_request(shape.vertices, shape.faces, config)
    # Piles simulated, or from the cache
    estimator = request.load_estimator().name
    of_rig = f"-rig{rig.number}" if options.container else ""
    name = f"{rig.family}-{rig.seed}-{options.piles}{of_rig}-{estimator}.json".replace(" ", "-")
    path = options.cache / name
    if not path.exists():
        piles = simulate_part_piles(request, options.piles, options.workers, lambda: None)
        path.write_text(json.dumps([asdict(pile) for pile in piles]) + "\n")
    stored = [Pile(_read_scan(pile["arc"]), _read_scan(pile["above"]))
              for pile in json.loads(path.read_text())]
    return fit_part_models(request, stored, estimator)


def _read_scan(values: dict | None) -> PileScan | None:
    """A pile's scan from the cache; None where it was refused."""
    if values is None:
        return None
    return PileScan(**{**values, "reading": Reading(**values["reading"])})


def _measure_volume(scene: Scene) -> StackVolume | None:
    try:
        return replace(reconstruct(scene, _SEED), mesh=None)
    except StackCounterError as error:
        print(f"scene {scene.index}: {error}")
        return None


def count_all_ways(rig: Rig, scans: list[tuple[Scene, StackVolume]], models: PartModels,
                   estimator: OccupancyEstimator, confidence: float) -> list[PartCount]:
    """Counts all scans of a rig by all that may be known of its part: all rows of the table."""
    shape = rig.scenes[0].shape
    form = form_of_mesh(shape.vertices, shape.faces)
    bare = Part(rig.scenes[0].truth.unit_volume, "part")
    with_size = replace(bare, outer_size_m=form.outer_size_m)
    with_mesh = replace(with_size, mesh_measures=form.mesh)
    from_cad = _PartWithModels(bare.unit_volume, "part", outer_size_m=form.outer_size_m,
                               mesh_measures=form.mesh, given_models=models)
    by_bins = [("", bare), ("CAD and ", from_cad)]
    counted_by = [[calibrate(part, volume, scene.truth.count, estimator, str(scene.index),
                             confidence, force=True).scan for scene, volume in scans]
                  for _, part in by_bins]
    counts = []
    for i, (scene, volume) in enumerate(scans):
        # What may be known: the other scans, counted, one by one and in threes
        parts = [("v only", bare), ("v and size", with_size), ("mesh", with_mesh),
                 ("CAD", from_cad)]
        for (title, part), counted in zip(by_bins, counted_by):
            others = [scan for k, scan in enumerate(counted) if k != i]
            for k, scan in enumerate(others):
                three = tuple(others[(k + j) % len(others)] for j in range(3))
                parts += [(f"{title}one counted scan", replace(part, counted=(scan,))),
                          (f"{title}three counted scans", replace(part, counted=three))]
        for row, part in parts:
            count = count_stack(volume, part, estimator, confidence)
            counts.append(PartCount(
                row, rig.number, scene.index, scene.truth.count, count.count,
                *count.count_interval, count.gamma_shares["estimator"], count.reasons))
    return counts


@dataclass(frozen=True)
class _PartWithModels(Part):
    """A part whose models are at hand, not in a file."""

    given_models: PartModels | None = None

    @property
    @override
    def models(self) -> PartModels | None:  # type: ignore[override]
        return self.given_models
