# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter simulate`: piles of parts, recordings and reports of them."""

from __future__ import annotations

import argparse
from pathlib import Path

from stack_counter.cli.common import positive_integer
from stack_counter.errors import ConfigError
from stack_counter.tasks.workers import Workers

_PLANS = ("mixed", "shallow", "deep", "box", "rig")


def add_simulate(commands: argparse._SubParsersAction) -> None:
    """Adds `simulate` to the commands of the command line."""
    simulate = commands.add_parser(
        "simulate", help="simulate piles of parts, or record simulated ones",
        description="Makes N scenes that are at rest in shards below DIR; `simulate bag` and "
                    "`simulate report` read them.")
    simulate.add_argument("--scenes", type=positive_integer, metavar="N")
    Workers.add_arguments(simulate)
    simulate.add_argument("--seed", type=int, default=0, metavar="S")
    simulate.add_argument("--out", type=Path, metavar="DIR")
    simulate.add_argument("--plan", default="mixed", choices=_PLANS,
                          help="containers and fills; box: as in the paper; rig: nine fills of "
                               "one container for each part")
    simulate.add_argument("--library", type=Path, metavar="FILE",
                          help="parts to take, not the training families: an .npz of shapes, or "
                               "of real solids with its index beside it (data/README.md)")
    simulate.set_defaults(run=_simulate)
    more = simulate.add_subparsers(metavar="bag | report")
    _add_bag(more)
    report = more.add_parser("report", help="one page with the statistics of a folder's scenes")
    report.add_argument("folder", type=Path, metavar="DIR")
    report.set_defaults(run=_report)


def _add_bag(commands: argparse._SubParsersAction) -> None:
    bag = commands.add_parser("bag", help="record one scene as a robot cell would")
    bag.add_argument("scene", metavar="SCENE", help="DIR:INDEX, e.g. data/unseen:12")
    bag.add_argument("bag", type=Path, metavar="OUT", help="bag to write (a new folder)")
    bag.add_argument("--views", type=positive_integer, default=12, help="of the arc (default 12)")
    bag.add_argument("--picks", type=positive_integer, metavar="K",
                     help="a fixed camera sees K parts taken away, one after the other")
    bag.add_argument("--cycles", type=positive_integer, metavar="K",
                     help="a station of four fixed cameras sees K fills, one after the other")
    bag.add_argument("--spread", type=positive_integer, metavar="K",
                     help="no pile: K pieces of the scene's part apart on a table")
    bag.add_argument("--noise-seed", type=int, default=0, metavar="S",
                     help="of poses, noise and materials")
    bag.set_defaults(run=_record)


def _simulate(options: argparse.Namespace) -> int:
    if options.scenes is None or options.out is None:
        raise ConfigError("simulate needs --scenes N and --out DIR")
    from stack_counter.sim.dataset import simulate

    simulate(options.out, options.scenes, Workers.of(options), options.seed, options.plan,
             options.library)
    return 0


def _record(options: argparse.Namespace) -> int:
    from stack_counter.sim.camera.bags import (
        write_picks_bag,
        write_scene_bag,
        write_spread_bag,
        write_station_bag,
    )
    from stack_counter.sim.scenes.shards import find_scene

    scene = find_scene(options.scene)
    if options.picks:
        write_picks_bag(scene, options.bag, options.picks, options.noise_seed)
    elif options.cycles:
        write_station_bag(scene, options.bag, options.cycles, options.noise_seed)
    elif options.spread:
        write_spread_bag(scene, options.bag, options.spread, options.views, options.noise_seed)
    else:
        write_scene_bag(scene, options.bag, options.views, options.noise_seed)
    place = "a table" if options.spread else f"container {scene.container.kind}"
    print(f"{options.bag}: {options.spread or len(scene.poses)} parts of "
          f"{scene.shape.unit_volume * 1e6:.6g} cm3 ({scene.shape.family}), {place}")
    return 0


def _report(options: argparse.Namespace) -> int:
    from stack_counter.sim.report import write_report

    print(write_report(options.folder))
    return 0
