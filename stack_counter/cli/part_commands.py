# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter part`: what is known of a part, from its CAD file to a count."""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from stack_counter.cli.common import chosen_time_range, require_bag
from stack_counter.config import Config, load_config
from stack_counter.errors import PartError
from stack_counter.files import config_path
from stack_counter.parts.catalogue import Part, find_part, load_parts, remove_part, save_part
from stack_counter.parts.gamma_model import GammaModel
from stack_counter.parts.part_lookup import resolve_part
from stack_counter.tasks.progress import progress_bar
from stack_counter.types import PartRequest

if TYPE_CHECKING:
    from stack_counter.parts.calibration import Calibration
    from stack_counter.teaching.add_part import PileKnowledge
    from stack_counter.teaching.tuning import Tuning

_LEAST_PILES = 32


def _load_settings(options: argparse.Namespace) -> tuple[Config, Path]:
    """Settings that name the catalogue to work on, and its path."""
    config = load_config(options.config or config_path("stack_counter.yaml"))
    given = options.catalogue or config.counter.part_catalogue
    path = Path(given) if given else config_path("parts.yaml")
    return replace(config, counter=replace(config.counter, part_catalogue=str(path))), path


def add(options: argparse.Namespace) -> int:
    """Teaches a part from its CAD file: simulates its piles."""
    from stack_counter.teaching.add_part import NewPart, add_part
    from stack_counter.teaching.part_mesh import load_part_mesh

    config, path = _load_settings(options)
    if options.piles and options.piles < _LEAST_PILES:
        raise PartError(f"--piles is {options.piles}; expected {_LEAST_PILES} or more, or 0")
    if options.tune and not options.piles:
        raise PartError("--tune with --piles 0; expected piles, to tune the network to")
    mesh = load_part_mesh(options.mesh, options.unit)
    print(f"{options.mesh.name}: {' x '.join(f'{1000 * s:.1f}' for s in mesh.size_m)} mm, v "
          f"{mesh.unit_volume * 1e6:.6g} cm3")
    for note in mesh.notes:
        print(f"note: {note}")
    request = NewPart(
        options.name, options.mesh, options.unit,
        density=options.density * 1e3 if options.density else None,
        friction=tuple(options.friction) if options.friction else None,
        piles=options.piles, workers=options.workers, tune=options.tune, force=options.force)
    with progress_bar("piles", "piles", options.piles) as on_pile:
        added = add_part(request, mesh, config, path, on_pile)
    if added.learnt is not None:
        _print_learnt(added.learnt)
    print(f"stored in {path}")
    return 0


def _print_learnt(learnt: PileKnowledge) -> None:
    """Prints what a part's piles have taught."""
    if (form := learnt.rough_form) is not None:
        print(f"note: simulated with convex pieces {form.fullness:.2f} times as full as the part, "
              f"which stand out of it by {form.protrusion:.0%} of its size: count a bin of it "
              "(part calibrate) before you rely on its gamma")
    if learnt.tuning is not None:
        print(_tuning_line(learnt.tuning))
    print(f"{learnt.models.made}\n{_gamma_lines(learnt.models.arc)}")


def _tuning_line(tuning: Tuning) -> str:
    before, after = (100 * math.sqrt(error) for error in (tuning.joined, tuning.tuned))
    return (f"tuning: error on piles left out {after:.1f}%, without it {before:.1f}%: "
            f"{'kept' if tuning.better else 'not kept'}")


def _gamma_lines(model: GammaModel) -> str:
    """Lines that say gamma over fills, and what it depends on."""
    width = 6.0
    lines = [f"gamma at a fill of {height} part lengths, {width:g} wide: {gamma:.3f} +- {std:.3f}"
             for height in (1, 2, 4, 8) for gamma, std in [model.gamma_at(height, width)]]
    return "\n".join([
        *lines, f"per 0.1 of friction {model.per_tenth_of_friction:+.1%}, per 10% of the "
                f"container's width {model.per_tenth_of_width(4, width):+.1%}"])


def measure_template(options: argparse.Namespace) -> int:
    """Measures v of a part from pieces on a table."""
    config, path = _load_settings(options)
    old = find_part(options.name, path)
    if options.pieces < 1:
        raise PartError(f"--pieces is {options.pieces}; expected 1 or more")
    if old is not None and old.mesh is not None and not options.force:
        raise PartError(f"part '{old.name}' has a mesh, by which v is {old.unit_volume * 1e6:.6g} "
                        "cm3; expected a part without (--force replaces it)")
    bag = require_bag(options.bag)
    from stack_counter.bag.replay import read_scan
    from stack_counter.parts.calibration import history_at_volume
    from stack_counter.parts.template import scan_template
    from stack_counter.parts.template_model import shipped_template_model

    # Measure v, then store it with what was known of the part.
    template = scan_template(read_scan(bag, config, chosen_time_range(options)),
                             options.pieces, config.reconstructor)
    v, std = shipped_template_model().unit_volume(template)
    save_part(Part(v, options.name, std, density=old.density if old else 0.0,
                   counted=history_at_volume(old, v, options.force),
                   note=f"{date.today()} from {options.pieces} pieces in {bag.resolve().name}",
                   outer_size_m=old.outer_size_m if old else None,
                   piece_weight=old.piece_weight if old and not options.force else None),
              path)
    if template.alike:
        print("note: all pieces look alike, as round parts do; if yours do not, turn some of them "
              "over and scan again")
    print(f"v {v * 1e6:.5g} cm3 +- {std / v:.1%}, from {options.pieces} pieces\nstored in {path}")
    return 0


def calibrate_gamma(options: argparse.Namespace) -> int:
    """Corrects a part's gamma by a counted bin."""
    config, path = _load_settings(options)
    part = resolve_part(PartRequest(options.name), str(path))
    if options.undo:
        return _undo_calibration(part, path)
    bag = require_bag(options.bag)
    from stack_counter.bag.replay import measure_bag
    from stack_counter.occupancy import make_estimator
    from stack_counter.parts.calibration import calibrate, count_from_weight

    # Measure the counted bin, and store what it says of gamma.
    count = options.count if options.count is not None \
        else count_from_weight(part, options.weight, options.piece_weight)
    estimator = make_estimator(config.counter)
    with progress_bar("scan", "views") as on_view:
        volume = measure_bag(bag, config, part.unit_volume, on_view,
                             chosen_time_range(options))
    calibration = calibrate(part, volume, count, estimator, bag.resolve().name,
                            config.counter.confidence, options.force)
    save_part(replace(part, counted=(*part.counted, calibration.scan)), path)
    _print_calibration(calibration, part, options.bag, path)
    return 0


def _undo_calibration(part: Part, path: Path) -> int:
    if not part.counted:
        raise PartError(f"part '{part.name}' has no counted bin; expected one to forget")
    last = part.counted[-1]
    save_part(replace(part, counted=part.counted[:-1]), path)
    print(f"forgot {last.bag}, {last.count} parts, of {last.date}; counted bins left: "
          f"{len(part.counted) - 1}")
    return 0


def _print_calibration(calibration: Calibration, part: Part, bag: Path, path: Path) -> None:
    """Prints what a counted bin says; `part` is as it was before."""
    from stack_counter.display.report import reason_lines

    estimate = calibration.count_without_it
    low, high = estimate.count_interval
    print(f"{bag}: {calibration.scan.count} parts; without this bin it would have been "
          f"{estimate.count}, between {low} and {high}")
    if estimate.reasons:
        print("\n".join([f"note: this scan is worth less by {', '.join(estimate.reasons)}",
                         *reason_lines(estimate.reasons)]))
    if calibration.drifted:
        print(f"warning: {abs(calibration.drift):.1f} standard deviations off the "
              f"counted bins before ({len(part.counted)}): has the part, the rig or the count "
              "changed? `--undo` forgets this one", file=sys.stderr)
    print(f"counted bins of '{part.name}': {len(part.counted) + 1}, stored in {path}")


def list_parts(options: argparse.Namespace) -> int:
    """Lists the parts that are known."""
    _, path = _load_settings(options)
    for name, part in sorted(load_parts(path).items()):
        std = f" +- {part.unit_volume_std * 1e6:.2g}" if part.unit_volume_std else ""
        size = "" if part.outer_size_m is None else "; " + " x ".join(
            f"{1e3 * side:.4g}" for side in part.outer_size_m) + " mm"
        measured = "; form of its mesh" if part.mesh_measures else ""
        made = f"; {part.models.made}" if part.models else ""
        print(f"{name}: v {part.unit_volume * 1e6:.6g}{std} cm3{size}{measured}{made}; "
              f"counted bins: {len(part.counted)}{f' ({part.note})' if part.note else ''}")
    return 0


def forget(options: argparse.Namespace) -> int:
    """Forgets a part."""
    _, path = _load_settings(options)
    remove_part(options.name, path)
    print(f"forgot '{options.name}' in {path}")
    return 0
