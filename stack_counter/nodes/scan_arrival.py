# SPDX-License-Identifier: Apache-2.0
"""Whether the images of a stopped scan are still on their way to the reconstructor. No ROS.

Time is counted in ticks of the node's own timer: while the node is busy, or gets no processor,
images wait in its own queue, and it is not they that are late.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ScanArrivalSettings:
    """How long a stopped scan waits for its images; all are chosen.

    Attributes:
        tick_s: seconds between two ticks.
        stops: ticks, each with a stop announced by the collector and without an image, after which
            the images are lost. The collector announces a stop every 2 s, and the middleware
            sends again what did not arrive every 3 s, both only while they run.
        silent_ticks: ticks in a row without image and stop after which the collector is gone:
            30 s; the middleware gives up a process that is silent for 20 s.
    """

    tick_s: float = 0.5
    stops: int = 8
    silent_ticks: int = 60


SETTINGS = ScanArrivalSettings()


class ScanArrival:
    """The images of one scan that have come, and the wait for the others.

    Attributes:
        received: number of images that have come.
    """

    def __init__(self) -> None:
        """Makes that of a scan without images."""
        self.received = 0
        self._stops = self._silent_ticks = 0  # since the last image
        self._image_since_tick = self._stop_since_tick = False

    def add_image(self) -> None:
        """Notes that an image was handled."""
        self.received += 1
        self._image_since_tick = True

    def add_stop(self) -> None:
        """Notes that the collector has announced the scan's end, for the first time or again."""
        self._stop_since_tick = True

    def on_tick(self) -> None:
        """Counts one tick of the wait; to be called while the scan is stopped."""
        if self._image_since_tick:
            self._stops = self._silent_ticks = 0
        elif self._stop_since_tick:
            self._stops, self._silent_ticks = self._stops + 1, 0
        else:
            self._silent_ticks += 1
        self._image_since_tick = self._stop_since_tick = False

    @property
    def is_given_up(self) -> bool:
        """Whether the images that have not come will not come any more."""
        return (self._stops >= SETTINGS.stops
                or self._silent_ticks >= SETTINGS.silent_ticks)
