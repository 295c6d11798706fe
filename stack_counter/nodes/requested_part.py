# SPDX-License-Identifier: Apache-2.0
"""The part that scans are asked to be of, by the catalogue as it is at each scan."""

from __future__ import annotations

from collections.abc import Callable

from stack_counter.errors import ConfigError, PartError
from stack_counter.parts.catalogue import resolve_part


class RequestedPart:
    """Name and unit volume of the part that was requested last."""

    def __init__(self, part: str, unit_volume: float, catalogue: str,
                 log_error: Callable[[str], object]):
        """Takes a first request.

        Args:
            part: its name; empty: the counter's own.
            unit_volume: its volume, m3; 0: that of the catalogue.
            catalogue: file of the known parts; empty: the shipped one.
            log_error: takes the line of a catalogue that can no longer be read.

        Raises:
            PartError: the part is unknown, or has no positive volume.
            ConfigError: the catalogue cannot be read.
        """
        self._catalogue, self._log_error = catalogue, log_error
        self.request(part, unit_volume)

    def request(self, part: str, unit_volume: float) -> None:
        """Replaces the request; the one before stays where this one is refused.

        Raises:
            PartError: the part is unknown, or has no positive volume.
            ConfigError: the catalogue cannot be read.
        """
        self._look_up(part, unit_volume)
        self._request = part, unit_volume

    def look_up(self) -> tuple[str, float]:
        """Returns name and unit volume, m3, by the catalogue as it is now.

        Where that fails, the request goes on as it is, for the counter to name the reason.
        """
        try:
            return self._look_up(*self._request)
        except (PartError, ConfigError) as error:
            self._log_error(str(error))
            return self._request

    def _look_up(self, part: str, unit_volume: float) -> tuple[str, float]:
        if not (part or unit_volume):
            return part, 0.0
        return part, resolve_part(part, unit_volume, self._catalogue).unit_volume
