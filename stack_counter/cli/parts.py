# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter part`: what is known of a part, from its CAD file to a count."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stack_counter.cli.common import (
    add_config_argument,
    add_time_arguments,
    chosen_time_range,
    positive_number,
    require_bag,
)
from stack_counter.config import Config, load_config
from stack_counter.errors import PartError
from stack_counter.files import config_path
from stack_counter.parts.catalogue import (
    MOST_FRICTION,
    Part,
    find_part,
    load_parts,
    remove_part,
    resolve_part,
    save_part,
)
from stack_counter.parts.gamma_model import GammaModel
from stack_counter.progress import progress_bar

if TYPE_CHECKING:
    from stack_counter.parts.calibration import Calibration
    from stack_counter.teaching.tuning import Tuning

_UNITS = ("mm", "m", "in")  # keys of teaching.solid_mesh.UNITS, without its imports
_LEAST_PILES = 32


def add_part(commands: argparse._SubParsersAction) -> None:
    """Adds `part` to the commands of the command line."""
    part = commands.add_parser("part", help="teach what is known of a part: its CAD file, a "
                                            "template, a counted bin")
    more = part.add_subparsers(required=True, metavar="add | template | calibrate | list | remove")
    _add_add(more)
    _add_template(more)
    _add_calibrate(more)
    listing = _command(more, "list", "the parts that are known")
    listing.set_defaults(run=_list)
    remove = _command(more, "remove", "forget a part")
    remove.add_argument("name", metavar="NAME")
    remove.set_defaults(run=_remove)


def _command(more: argparse._SubParsersAction, name: str, text: str) -> argparse.ArgumentParser:
    command = more.add_parser(name, help=text)
    add_config_argument(command)
    command.add_argument("--catalogue", type=Path, metavar="FILE",
                         help="default: the configured one, config/parts.yaml")
    return command


def _add_add(more: argparse._SubParsersAction) -> None:
    add = _command(more, "add", "v and gamma of a part from its CAD file: simulates its piles")
    add.add_argument("name", type=_nonempty, metavar="NAME", help="what --part calls it")
    add.add_argument("--mesh", type=Path, required=True, metavar="FILE",
                     help="STL, OBJ, PLY, OFF or STEP, one watertight body")
    add.add_argument("--unit", choices=_UNITS, default="mm",
                     help="of the mesh's numbers (default mm; STEP says its own)")
    add.add_argument("--density", type=positive_number, metavar="G_CM3",
                     help="of the material, g/cm3")
    add.add_argument("--friction", type=_friction, nargs=2, metavar=("LOW", "HIGH"),
                     help="of parts on each other, if known (default 0.05 0.6)")
    add.add_argument("--piles", type=int, default=64, metavar="N", help="(default 64)")
    add.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="W",
                     help="processes (default: one a core)")
    add.add_argument("--tune", action="store_true",
                     help="adapt the network's last layers to the piles, where that is better")
    add.add_argument("--force", action="store_true",
                     help="replace a part of another v, and forget its counted bins")
    add.set_defaults(run=_add)


def _add_template(more: argparse._SubParsersAction) -> None:
    template = _command(more, "template", "v of a part without CAD file, from pieces on a table")
    template.add_argument("name", type=_nonempty, metavar="NAME", help="what --part calls it")
    template.add_argument("bag", type=Path, metavar="BAG",
                          help="recording of the pieces, apart from each other, nothing else "
                               "beside them; best in different rest poses")
    template.add_argument("--pieces", type=int, required=True, metavar="K", help="how many")
    add_time_arguments(template)
    template.add_argument("--force", action="store_true", help="as for add")
    template.set_defaults(run=_template)


def _add_calibrate(more: argparse._SubParsersAction) -> None:
    calibrate = _command(more, "calibrate", "correct a part's gamma on this rig by a counted bin")
    calibrate.add_argument("name", metavar="NAME")
    calibrate.add_argument("bag", type=Path, nargs="?", metavar="BAG", help="recording of the bin")
    add_time_arguments(calibrate)
    known = calibrate.add_mutually_exclusive_group(required=True)
    known.add_argument("--count", type=int, metavar="N", help="parts in it")
    known.add_argument("--weight", type=positive_number, metavar="KG", help="of the parts in it")
    known.add_argument("--undo", action="store_true", help="forget the last counted bin")
    calibrate.add_argument("--piece-weight", type=positive_number, default=0.0, metavar="G",
                           help="of one part; default: from its density")
    calibrate.add_argument("--force", action="store_true",
                           help="take a count that is implausible, or of another rig")
    calibrate.set_defaults(run=_calibrate)


def _nonempty(text: str) -> str:
    if not text.strip() or "/" in text:
        raise argparse.ArgumentTypeError(f"'{text}'; expected a name without /")
    return text


def _friction(text: str) -> float:
    value = positive_number(text)
    if value > MOST_FRICTION:
        raise argparse.ArgumentTypeError(f"'{text}'; expected {MOST_FRICTION:g} or less")
    return value


def _load_settings(options: argparse.Namespace) -> tuple[Config, Path]:
    """Settings that name the catalogue to work on, and its path."""
    config = load_config(options.config or config_path("stack_counter.yaml"))
    given = options.catalogue or config.counter.part_catalogue
    path = Path(given) if given else config_path("parts.yaml")
    return replace(config, counter=replace(config.counter, part_catalogue=str(path))), path


def _add(options: argparse.Namespace) -> int:
    from stack_counter.teaching.add_part import PartRequest, add_part
    from stack_counter.teaching.part_mesh import load_part_mesh

    config, path = _load_settings(options)
    if options.piles < _LEAST_PILES:
        raise PartError(f"--piles is {options.piles}; expected {_LEAST_PILES} or more")
    mesh = load_part_mesh(options.mesh, options.unit)
    print(f"{options.mesh.name}: {' x '.join(f'{1000 * s:.1f}' for s in mesh.size_m)} mm, v "
          f"{mesh.unit_volume * 1e6:.6g} cm3")
    for note in mesh.notes:
        print(f"note: {note}")
    request = PartRequest(
        options.name, options.mesh, options.unit,
        density=options.density * 1e3 if options.density else None,
        friction=tuple(options.friction) if options.friction else None,
        piles=options.piles, workers=options.workers, tune=options.tune, force=options.force)
    with progress_bar("piles", "piles", options.piles) as on_pile:
        added = add_part(request, mesh, config, path, on_pile)
    if added.rough_form is not None:
        print(f"note: simulated with convex pieces {added.rough_form.fullness:.2f} times as full "
              f"as the part, which stand out of it by {added.rough_form.protrusion:.0%} of its "
              "size: count a bin of it (part calibrate) before you rely on its gamma")
    if added.tuning is not None:
        print(_tuning_line(added.tuning))
    print(f"{added.models.made}\n{_gamma_lines(added.models.arc)}\nstored in {path}")
    return 0


def _tuning_line(tuning: Tuning) -> str:
    before, after = (100 * np.sqrt(error) for error in (tuning.joined, tuning.tuned))
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


def _template(options: argparse.Namespace) -> int:
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
                   note=f"{date.today()} from {options.pieces} pieces in {bag.resolve().name}"),
              path)
    if template.alike:
        print("note: all pieces look alike, as round parts do; if yours do not, turn some of them "
              "over and scan again")
    print(f"v {v * 1e6:.5g} cm3 +- {std / v:.1%}, from {options.pieces} pieces\nstored in {path}")
    return 0


def _calibrate(options: argparse.Namespace) -> int:
    config, path = _load_settings(options)
    part = resolve_part(options.name, 0.0, str(path))
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


def _list(options: argparse.Namespace) -> int:
    _, path = _load_settings(options)
    for name, part in sorted(load_parts(path).items()):
        std = f" +- {part.unit_volume_std * 1e6:.2g}" if part.unit_volume_std else ""
        made = f"; {part.models.made}" if part.models else ""
        print(f"{name}: v {part.unit_volume * 1e6:.6g}{std} cm3{made}; counted bins: "
              f"{len(part.counted)}{f' ({part.note})' if part.note else ''}")
    return 0


def _remove(options: argparse.Namespace) -> int:
    _, path = _load_settings(options)
    remove_part(options.name, path)
    print(f"forgot '{options.name}' in {path}")
    return 0
