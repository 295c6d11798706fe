# SPDX-License-Identifier: Apache-2.0
"""The option `--arrangement` of `stack-counter replay`: what may lie below the surface."""

from __future__ import annotations

import argparse
import os
import sys

from stack_counter.config import Config
from stack_counter.errors import ConfigError, PartError, StackCounterError
from stack_counter.parts.catalogue import Part
from stack_counter.types import Arrangement, StackCount


def add_arrangement_argument(replay: argparse.ArgumentParser) -> None:
    """Adds `--arrangement` to the command."""
    replay.add_argument("--arrangement", action="store_true",
                        help="simulate piles of the part's mesh and show in the report how the "
                             "hidden parts may lie; takes about a minute")


def check_arrangement(options: argparse.Namespace, config: Config, part: Part) -> None:
    """Refuses, before anything is counted, what could not be arranged or shown.

    Raises:
        ConfigError: there is no report to show it in, or there are several stacks.
        PartError: the part has no mesh.
    """
    if not options.arrangement:
        return
    if options.report is None:
        raise ConfigError("--arrangement without --report; expected --report DIR, in whose page "
                          "the arrangement is shown")
    if config.reconstructor.regions:
        raise ConfigError(f"--arrangement with {len(config.reconstructor.regions)} named regions; "
                          "expected one stack: name one region's corners as region_of_interest")
    if part.mesh is None:
        raise PartError(f"--arrangement with part '{part.name or 'of a given volume'}', which has "
                        "no mesh; expected one: stack-counter part add NAME --mesh FILE")


def simulate_arrangement(part: Part, count: StackCount) -> Arrangement | None:
    """Simulates piles of the part; None, and a line that says why, where that fails."""
    from stack_counter.sim import shape_from_mesh
    from stack_counter.teaching.part_mesh import load_mesh_of_volume
    from stack_counter.teaching.plausible_arrangement import find_arrangement

    assert part.mesh is not None  # checked before the count
    try:
        mesh = load_mesh_of_volume(part.mesh, part.unit_volume)
        shape = shape_from_mesh(mesh.vertices, mesh.faces, part.name)
        return find_arrangement(count, shape, part.friction, os.cpu_count() or 1)
    except (OSError, StackCounterError) as error:
        print(f"stack-counter: {error}", file=sys.stderr)
        return None
