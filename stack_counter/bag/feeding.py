# SPDX-License-Identifier: Apache-2.0
"""Gives a counter the views of a bag: all of them, or one cycle after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass

from stack_counter.bag.bag_views import BagViews
from stack_counter.errors import ViewError
from stack_counter.pipeline import StackCounter
from stack_counter.region_counters import RegionCounters
from stack_counter.types import View
from stack_counter.views.cycles import Cycle, CycleGrouper


@dataclass(frozen=True, eq=False)
class FedCycle:
    """One cycle of a rig's cameras, of which a counter has all views.

    Attributes:
        stamp_ns: when it began.
        missing_cameras: names of the cameras that gave it no view.
    """

    stamp_ns: int
    missing_cameras: list[str]


def feed_scan(counter: StackCounter | RegionCounters, bag: BagViews,
              after_view: Callable[[], None], rate: float = 0.0) -> None:
    """Gives a counter all the views of a bag.

    Args:
        counter: started.
        bag: not yet read.
        after_view: called after each view used.
        rate: 0, or the speed of the recording's clock.

    Raises:
        BagError: a message of the bag does not decode.
    """
    begin, first_ns, overrun = time.perf_counter(), None, bag.reader.overrun
    for _, view in bag:
        # Wait until the view is due.
        first_ns = view.stamp_ns if first_ns is None else first_ns
        if rate:
            due = begin + (view.stamp_ns - first_ns) * 1e-9 / rate
            time.sleep(max(due - time.perf_counter(), 0))
        # Leave out what the recorded scan had left out.
        if (view.camera, view.stamp_ns) in overrun:
            counter.skip_view(ViewError("overrun",
                                        "the recorded scan had no time for this view"))
            continue
        with suppress(ViewError):  # counted in the tally
            counter.add_view(view)
            after_view()


def feed_cycles(counter: StackCounter | RegionCounters, bag: BagViews, unit_volume: float,
                on_view: Callable[[], None]) -> Iterator[FedCycle]:
    """Gives a counter the views of one cycle after the other; it is measured before the next."""
    rig = bag.assembler.rig
    grouper = CycleGrouper([c.name for c in rig.cameras], rig.tolerance_s, rig.timeout_s,
                           live=False)
    for cycle in grouped_cycles(bag, grouper):
        counter.start(unit_volume)
        for name in grouper.cameras:
            with suppress(ViewError):  # counted in the tally
                if name in cycle.views:
                    counter.add_view(cycle.views[name])
                    on_view()
        yield FedCycle(cycle.stamp_ns, grouper.missing_cameras(cycle))


def grouped_cycles(views: Iterable[tuple[str, View]], grouper: CycleGrouper) -> Iterator[Cycle]:
    """Groups the views of a rig's cameras into cycles; a view that is late is left out."""
    for name, view in views:
        with suppress(ViewError):
            yield from grouper.add_view(name, view)
    yield from grouper.close_all()
