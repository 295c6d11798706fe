# SPDX-License-Identifier: Apache-2.0
"""What every estimator of gamma offers."""

from __future__ import annotations

from typing import Protocol

from stack_counter.types import KnownForm, OccupancyEstimate, StackVolume


class OccupancyEstimator(Protocol):
    """Estimates which fraction of a stack's volume the parts fill.

    Attributes:
        name: as messages and files name the estimator, with its version.
    """

    name: str

    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        """Estimates gamma of a stack whose parts have `unit_volume` (m3) each.

        Raises:
            ScanError: the volume holds nothing that this estimator can read.
        """
        ...

    def knowing(self, form: KnownForm) -> OccupancyEstimator:
        """The estimator for parts of whose form so much is known; by default it is the same."""
        return self
