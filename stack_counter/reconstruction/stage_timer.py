# SPDX-License-Identifier: Apache-2.0
"""Seconds that a scan spends in each stage; a stage may lie within another."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager


class StageTimer:
    """Adds up the time spent by stage: `with timer("integrate"): ...`."""

    def __init__(self) -> None:
        """Makes a timer without stages."""
        self._seconds: defaultdict[str, float] = defaultdict(float)

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds so far by the stage's name."""
        return dict(self._seconds)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Adds the time of a `with` block to a stage."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[stage] += time.perf_counter() - begin
