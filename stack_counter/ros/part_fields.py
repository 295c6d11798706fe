# SPDX-License-Identifier: Apache-2.0
"""The fields by which messages, requests and goals name a part."""

from __future__ import annotations

from typing import Any

from stack_counter.types import PartRequest


def from_part_fields(message: Any) -> PartRequest:
    """Returns the part that a message, request or goal names."""
    return PartRequest(message.part, message.unit_volume, tuple(map(float, message.part_size)))


def to_part_fields(part: PartRequest) -> dict[str, Any]:
    """Returns the fields of a message, request or goal that names a part."""
    return {"part": part.name, "unit_volume": part.unit_volume,
            "part_size": list(part.outer_size_m)}
