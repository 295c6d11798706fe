# SPDX-License-Identifier: Apache-2.0
"""The option `--arrangement` of `stack-counter replay`: what may lie below the surface."""

from __future__ import annotations

import argparse
import os
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING

from stack_counter.config import Config
from stack_counter.errors import ConfigError, PartError, StackCounterError, defect_line
from stack_counter.parts.catalogue import Part
from stack_counter.types import Arrangement, StackCount

if TYPE_CHECKING:
    from stack_counter.sim import Shape


def add_arrangement_argument(replay: argparse.ArgumentParser) -> None:
    """Adds `--arrangement` to the command."""
    replay.add_argument("--arrangement", action="store_true",
                        help="simulate piles of the part's mesh and show in the report how the "
                             "hidden parts may lie; takes about a minute")


def load_arranged_shape(options: argparse.Namespace, config: Config, part: Part) -> Shape | None:
    """Loads the part for an arrangement; None where none is asked for.

    Raises:
        ConfigError: there is no report to show it in, there are several stacks, or the simulator
            is not installed.
        PartError: the part has no mesh.
        MeshError: the mesh is no solid, or of another volume.
        FileNotFoundError: the mesh is not where the catalogue says.
    """
    if not options.arrangement:
        return None
    if options.report is None:
        raise ConfigError("--arrangement without --report; expected --report DIR, in whose page "
                          "the arrangement is shown")
    if config.reconstructor.regions:
        raise ConfigError(f"--arrangement with {len(config.reconstructor.regions)} named regions; "
                          "expected one stack: give one of them as roi_center_m and roi_size_m")
    if part.mesh is None:
        raise PartError(f"--arrangement with part '{part.name or 'of a given volume'}', which has "
                        "no mesh; expected one: stack-counter part add NAME --mesh FILE")
    if find_spec("sapien") is None:
        raise ConfigError("--arrangement takes the package sapien, which is not installed; "
                          "expected make setup (not setup-cell) with Python 3.11 or 3.12")
    from stack_counter.sim import shape_from_mesh
    from stack_counter.teaching.part_mesh import load_mesh_of_volume

    mesh = load_mesh_of_volume(part.mesh, part.unit_volume)
    return shape_from_mesh(mesh.vertices, mesh.faces, part.name)


def simulate_arrangement(shape: Shape, part: Part, count: StackCount) -> Arrangement | None:
    """Simulates piles of a part; None, and a line that says why, where that fails."""
    from stack_counter.teaching.plausible_arrangement import find_arrangement

    try:
        return find_arrangement(count, shape, part.friction, os.cpu_count() or 1)
    except StackCounterError as error:
        print(f"stack-counter: {error}", file=sys.stderr)
    except Exception as error:  # the count is there, and its report is to stay
        print(f"stack-counter: {defect_line('arranged', error)}", file=sys.stderr)
    return None
