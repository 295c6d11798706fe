"""The command `stack-counter part`: what is known of a part, from its CAD file to a count."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from stack_counter.config import Config, load
from stack_counter.errors import PartError
from stack_counter.files import config_path
from stack_counter.parts.catalogue import (
    MOST_FRICTION,
    Part,
    load_parts,
    remove_part,
    resolve_part,
    save_part,
)
from stack_counter.parts.counted_scan import CountedScan
from stack_counter.parts.gamma_model import GammaModel, PartModels

if TYPE_CHECKING:
    from stack_counter.teaching.simulated_piles import Pile, PileRequest

_SAME_VOLUME = 0.01  # relative; a part whose v changes by more is another part,
_SURE = 3.0  # or by more than so many standard deviations of a v that was measured
_UNITS = ("mm", "m", "in")  # those of part.mesh.UNITS, without its imports


def add_part(commands: argparse._SubParsersAction) -> None:
    """Adds the command to the command line's."""
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
    command.add_argument("--config", type=Path, metavar="FILE", help="settings (ROS parameters)")
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
    add.add_argument("--density", type=_above_0, metavar="G_CM3", help="of the material, g/cm3")
    add.add_argument("--friction", type=_friction, nargs=2, metavar=("LOW", "HIGH"),
                     help="of parts on each other, if known (default 0.2 0.7)")
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
    template.add_argument("--force", action="store_true", help="as for add")
    template.set_defaults(run=_template)


def _add_calibrate(more: argparse._SubParsersAction) -> None:
    calibrate = _command(more, "calibrate", "correct a part's gamma on this rig by a counted bin")
    calibrate.add_argument("name", metavar="NAME")
    calibrate.add_argument("bag", type=Path, nargs="?", metavar="BAG", help="recording of the bin")
    known = calibrate.add_mutually_exclusive_group(required=True)
    known.add_argument("--count", type=int, metavar="N", help="parts in it")
    known.add_argument("--weight", type=_above_0, metavar="KG", help="of the parts in it")
    known.add_argument("--undo", action="store_true", help="forget the last counted bin")
    calibrate.add_argument("--piece-weight", type=_above_0, default=0.0, metavar="G",
                           help="of one part; default: from its density")
    calibrate.add_argument("--force", action="store_true",
                           help="take a count that is implausible, or of another rig")
    calibrate.set_defaults(run=_calibrate)


def _nonempty(text: str) -> str:
    if not text.strip() or "/" in text:
        raise argparse.ArgumentTypeError(f"'{text}'; expected a name without /")
    return text


def _above_0(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not (np.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"'{text}'; expected a number above 0")
    return value


def _friction(text: str) -> float:
    value = _above_0(text)
    if value > MOST_FRICTION:
        raise argparse.ArgumentTypeError(f"'{text}'; expected {MOST_FRICTION:g} or less")
    return value


def _opened(options: argparse.Namespace) -> tuple[Config, Path]:
    """Settings, with the catalogue that is meant, and its path."""
    config = load(options.config or config_path("stack_counter.yaml"))
    given = options.catalogue or config.counter.part_catalogue
    path = Path(given) if given else config_path("parts.yaml")
    return replace(config, counter=replace(config.counter, part_catalogue=str(path))), path


def _add(options: argparse.Namespace) -> int:
    from stack_counter.sim import FRICTION
    from stack_counter.teaching.add_part import make_order, models_of, simulate_part
    from stack_counter.teaching.part_mesh import load_part_mesh

    config, path = _opened(options)
    if options.piles < 32:
        raise PartError(f"--piles is {options.piles}; expected 32 or more")
    old = _entry(options.name, path)
    mesh = load_part_mesh(options.mesh, options.unit)
    print(f"{options.mesh.name}: {' x '.join(f'{1000 * s:.1f}' for s in mesh.size_m)} mm, v "
          f"{mesh.unit_volume * 1e6:.6g} cm3")
    for note in mesh.notes:
        print(f"note: {note}")
    _kept_history(old, mesh.unit_volume, options.force)  # or say why not
    low, high = sorted(options.friction or (old.friction if old and old.friction else FRICTION))
    order = make_order(mesh.vertices, mesh.faces, config, (low, high), options.tune)
    with tqdm(total=options.piles, unit=" piles", desc="piles",
              disable=not sys.stderr.isatty()) as bar:
        piles = simulate_part(order, options.piles, options.workers, lambda: bar.update() and None)
    folder = path.parent / "parts"
    folder.mkdir(parents=True, exist_ok=True)
    tuned = folder / f"{options.name}.safetensors" if options.tune else None
    models = models_of(order, piles)
    if tuned is not None:
        models, tuned = _tuned_models(order, piles, models, tuned)
    prior = folder / f"{options.name}.json"
    models.write(prior)
    stored = folder / f"{options.name}{options.mesh.suffix.lower()}"
    if stored.resolve() != options.mesh.resolve():
        shutil.copyfile(options.mesh, stored)
    old = _entry(options.name, path)  # bins may have been counted meanwhile
    kept = _kept_history(old, mesh.unit_volume, options.force)
    density = options.density * 1e3 if options.density else old.density if old else 0.0
    save_part(Part(mesh.unit_volume, options.name, 0.0, stored, density, (low, high), prior, tuned,
                   f"{date.today()} from {options.mesh.name}, unit {options.unit}", kept), path)
    print(f"{models.made}\n{_gamma_lines(models.arc)}\nstored in {path}")
    return 0


def _tuned_models(order: PileRequest, piles: list[Pile], models: PartModels, path: Path
                  ) -> tuple[PartModels, Path | None]:
    """Those of the tuned network if it is better on piles left out, else the same."""
    from stack_counter.occupancy.gamma_net import save_tuning, tuned_name
    from stack_counter.teaching.add_part import models_of
    from stack_counter.teaching.tuning import tune

    tuning = tune(piles)
    before, after = (100 * np.sqrt(x) for x in (tuning.joined, tuning.tuned))
    if not tuning.better:
        print(f"tuning: error on piles left out {after:.1f}%, without it {before:.1f}%: not kept")
        return models, None
    save_tuning(path, tuning.weight, tuning.bias, models.estimator)
    print(f"tuning: error on piles left out {after:.1f}%, without it {before:.1f}%: kept")
    name = tuned_name(models.estimator, tuning.weight, tuning.bias)
    return models_of(order, tuning.piles, name), path


def _template(options: argparse.Namespace) -> int:
    config, path = _opened(options)
    old = _entry(options.name, path)
    if options.pieces < 1:
        raise PartError(f"--pieces is {options.pieces}; expected 1 or more")
    if old is not None and old.mesh is not None and not options.force:
        raise PartError(f"part '{old.name}' has a mesh, by which v is {old.unit_volume * 1e6:.6g} "
                        "cm3; expected a part without (--force replaces it)")
    if not options.bag.exists():
        raise FileNotFoundError(f"no bag {options.bag}; expected a rosbag2 folder or .mcap file")
    from stack_counter.bag.replay import read_scan
    from stack_counter.parts.template import scan_template, shipped

    template = scan_template(read_scan(options.bag, config), options.pieces, config.reconstructor)
    v, std = shipped().unit_volume(template)
    kept = _kept_history(old, v, options.force)
    save_part(Part(v, options.name, std, density=old.density if old else 0.0, counted=kept,
                   note=f"{date.today()} from {options.pieces} pieces in "
                        f"{options.bag.resolve().name}"), path)
    if template.alike:
        print("note: all pieces look alike, as round parts do; if yours do not, turn some of them "
              "over and scan again")
    print(f"v {v * 1e6:.5g} cm3 +- {std / v:.1%}, from {options.pieces} pieces\nstored in {path}")
    return 0


def _entry(name: str, path: Path) -> Part | None:
    return (load_parts(path) if path.exists() else {}).get(name)


def _kept_history(old: Part | None, unit_volume: float, force: bool) -> tuple[CountedScan, ...]:
    """The counted bins of a part that is replaced by itself, with its new v."""
    if old is None:
        return ()
    ratio = unit_volume / old.unit_volume
    if abs(ratio - 1) < max(_SAME_VOLUME, _SURE * old.relative_std):
        return tuple(replace(scan, log_gamma=scan.log_gamma + float(np.log(ratio)))
                     for scan in old.counted)
    if not force:
        raise PartError(f"part '{old.name}' is there with v {old.unit_volume * 1e6:.6g} cm3; "
                        f"expected about that, not {unit_volume * 1e6:.6g} cm3 (--force replaces "
                        f"it and forgets its counted bins: {len(old.counted)})")
    return ()


def _gamma_lines(model: GammaModel) -> str:
    """gamma over fills, and what it depends on."""
    width = 6.0
    lines = [f"gamma at a fill of {height} part lengths, {width:g} wide: {gamma:.3f} +- {std:.3f}"
             for height in (1, 2, 4, 8) for gamma, std in [model.gamma_at(height, width)]]
    return "\n".join([
        *lines, f"per 0.1 of friction {model.per_tenth_of_friction:+.1%}, per 10% of the "
                f"container's width {model.per_tenth_of_width(4, width):+.1%}"])


def _calibrate(options: argparse.Namespace) -> int:
    config, path = _opened(options)
    part = resolve_part(options.name, 0.0, str(path))
    if options.undo:
        if not part.counted:
            raise PartError(f"part '{part.name}' has no counted bin; expected one to forget")
        last = part.counted[-1]
        save_part(replace(part, counted=part.counted[:-1]), path)
        print(f"forgot {last.bag}, {last.count} parts, of {last.date}; counted bins left: "
              f"{len(part.counted) - 1}")
        return 0
    if options.bag is None or not options.bag.exists():
        raise FileNotFoundError(f"no bag {options.bag}; expected a rosbag2 folder or .mcap file")
    from stack_counter.bag.replay import measure_bag
    from stack_counter.occupancy.baselines import make_estimator
    from stack_counter.parts.calibration import count_from_weight, counted_scan

    count = (
        count_from_weight(part, options.weight, options.piece_weight)
        if options.count is None
        else options.count
    )
    estimator = make_estimator(config.counter)
    with tqdm(unit=" views", desc="scan", disable=not sys.stderr.isatty()) as bar:
        volume = measure_bag(options.bag, config, part.unit_volume, lambda: bar.update() and None)
    counted = counted_scan(part, volume, count, estimator, options.bag.resolve().name,
                           config.counter.confidence, options.force)
    save_part(replace(part, counted=(*part.counted, counted.scan)), path)
    low, high = counted.before.count_interval
    print(f"{options.bag}: {count} parts; without this bin it would have been "
          f"{counted.before.count}, between {low} and {high}")
    if counted.before.reasons:
        print(f"note: this scan is worth less by {', '.join(counted.before.reasons)}")
    if counted.drifted:
        print(f"warning: {abs(counted.drift):.1f} standard deviations off the "
              f"counted bins before ({len(part.counted)}): has the part, the rig or the count "
              "changed? `--undo` forgets this one", file=sys.stderr)
    print(f"counted bins of '{part.name}': {len(part.counted) + 1}, stored in {path}")
    return 0


def _list(options: argparse.Namespace) -> int:
    _, path = _opened(options)
    for name, part in sorted(load_parts(path).items()):
        std = f" +- {part.unit_volume_std * 1e6:.2g}" if part.unit_volume_std else ""
        made = f"; {part.models.made}" if part.models else ""
        print(f"{name}: v {part.unit_volume * 1e6:.6g}{std} cm3{made}; counted bins: "
              f"{len(part.counted)}{f' ({part.note})' if part.note else ''}")
    return 0


def _remove(options: argparse.Namespace) -> int:
    _, path = _opened(options)
    remove_part(options.name, path)
    print(f"forgot '{options.name}' in {path}")
    return 0
