# SPDX-License-Identifier: Apache-2.0
"""Which part a scan is of, as somebody asks for it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PartRequest:
    """What is said of the part.

    Attributes:
        name: in the part catalogue; empty if only v is given.
        unit_volume: v, m3; 0: that of the catalogue.
        outer_size_m: sides of the box around one part, metres; zeros: those of the catalogue.
    """

    name: str = ""
    unit_volume: float = 0.0
    outer_size_m: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def names_a_part(self) -> bool:
        """Whether it says which part; dimensions alone do not."""
        return bool(self.name or self.unit_volume)
