# SPDX-License-Identifier: Apache-2.0
"""From what somebody says of a part to what is known of it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from stack_counter.config import CollectorConfig, CounterConfig
from stack_counter.counting import check_unit_volume
from stack_counter.errors import PartError
from stack_counter.parts.catalogue import Part, load_parts
from stack_counter.parts.entry_checks import check_outer_size
from stack_counter.types import PartRequest

_SAME_SIZE = 0.1  # by how much a side that is measured by hand may differ; chosen


def configured_part(config: CollectorConfig | CounterConfig) -> PartRequest:
    """The part that a node's settings name; an empty request where they name none."""
    return PartRequest(config.part, config.unit_volume_m3, config.part_size_m)


def check_names_a_part(request: PartRequest) -> None:
    """Refuses outer dimensions of nobody knows which part.

    Raises:
        PartError: there are some, and neither name nor v.
    """
    if any(request.outer_size_m) and not request.names_a_part:
        raise PartError(f"part_size is {list(request.outer_size_m)} m without part or unit_volume;"
                        " expected one of them beside it")


def resolve_part(request: PartRequest, catalogue: str = "") -> Part:
    """Looks up the part that is asked for, or makes one of which no more is known than is said.

    A v that is not the named part's own overrides all that is known of it; outer dimensions
    override its own.

    Args:
        request: which part.
        catalogue: file; empty is the shipped one.

    Raises:
        PartError: neither name nor v is given, the name is unknown, v is no positive number or
            not held by the outer dimensions, or the part's models cannot be read.
        ConfigError: the catalogue is missing or malformed.
    """
    name, unit_volume = request.name, request.unit_volume
    if not request.names_a_part:
        raise PartError("no part named and no unit volume given; expected one of them")
    parts = load_parts(Path(catalogue) if catalogue else None) if name else {}
    part = parts.get(name)
    if part and (not unit_volume or math.isclose(unit_volume, part.unit_volume, rel_tol=1e-9)):
        return _with_size(part, request.outer_size_m).with_models_read()
    if unit_volume:
        overridden = bool(part and (part.gamma_prior or part.counted))
        return _with_size(Part(check_unit_volume(unit_volume), name, overridden=overridden),
                          request.outer_size_m)
    raise PartError(f"unknown part '{name}'; expected one of {sorted(parts)}")


def _with_size(part: Part, outer_size_m: tuple[float, ...]) -> Part:
    """The part with outer dimensions that somebody gives; zeros leave it as it is."""
    if not any(outer_size_m):
        return part
    try:
        size = check_outer_size(outer_size_m, part.unit_volume)
    except ValueError as error:
        raise PartError(str(error)) from error
    # A mesh of another size is that of another part.
    own = sorted(part.outer_size_m or size)
    alike = all(math.isclose(a, b, rel_tol=_SAME_SIZE) for a, b in zip(sorted(size), own))
    return replace(part, outer_size_m=size, mesh_measures=part.mesh_measures if alike else None)
