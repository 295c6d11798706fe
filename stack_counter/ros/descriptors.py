# SPDX-License-Identifier: Apache-2.0
"""Descriptions of the nodes' parameters, as tools of ROS 2 show them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor


def describe_parameter(field: dataclasses.Field) -> ParameterDescriptor:
    """Returns the description and range of a settings field, as `ros2 param describe` shows it."""
    meta = field.metadata
    choices = f" (one of: {', '.join(meta['choices'])})" if meta["choices"] else ""
    descriptor = ParameterDescriptor(description=meta["doc"] + choices,
                                     additional_constraints=_when_it_may_change(meta))
    low, high = meta["low"], meta["high"]
    if low is not None and high is not None:
        if isinstance(field.default, float):
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=float(low), to_value=float(high))]
        elif isinstance(field.default, int):
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high),
                                                     step=1)]
    return descriptor


def _when_it_may_change(meta: Mapping[str, Any]) -> str:
    """Says when a parameter may be set, by the metadata of its field."""
    if meta["path"]:
        inline = "; its text in braces may change at run time" if meta["runtime"] else ""
        return f"a path: set it when the node is started{inline}"
    return "may change at run time" if meta["runtime"] \
        else "read on configure; set it while the node is unconfigured"
