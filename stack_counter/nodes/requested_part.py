# SPDX-License-Identifier: Apache-2.0
"""The part that scans are asked to be of, by the catalogue as it is at each scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from stack_counter.errors import ConfigError, PartError
from stack_counter.parts.part_lookup import check_names_a_part, resolve_part
from stack_counter.types import PartRequest


class RequestedPart:
    """The part that was requested last."""

    def __init__(self, part: PartRequest, catalogue: str, log_error: Callable[[str], object]):
        """Takes a first request.

        Args:
            part: the first request; an empty one leaves the part to the counter.
            catalogue: file of the known parts; empty: the shipped one.
            log_error: takes the line of a catalogue that can no longer be read.

        Raises:
            PartError: the part is unknown, or has no positive volume.
            ConfigError: the catalogue cannot be read.
        """
        self._catalogue, self._log_error = catalogue, log_error
        self.request(part)

    def request(self, part: PartRequest) -> None:
        """Replaces the request; the one before stays where this one is refused.

        Raises:
            PartError: the part is unknown, or has no positive volume.
            ConfigError: the catalogue cannot be read.
        """
        self._look_up(part)
        self._request = part

    def look_up(self) -> PartRequest:
        """Returns the request with v by the catalogue as it is now.

        Where that fails, the request goes on as it is, for the counter to name the reason.
        """
        try:
            return self._look_up(self._request)
        except (PartError, ConfigError) as error:
            self._log_error(str(error))
            return self._request

    def _look_up(self, part: PartRequest) -> PartRequest:
        if not part.names_a_part:
            check_names_a_part(part)
            return part
        return replace(part, unit_volume=resolve_part(part, self._catalogue).unit_volume)
