# SPDX-License-Identifier: Apache-2.0
"""When a stopped scan's images are lost, and when they only wait."""

from stack_counter.nodes.scan_arrival import SETTINGS, ScanArrival

# The collector announces a stop every 2 s.
TICKS_PER_STOP = round(2.0 / SETTINGS.tick_s)


def wait(arrival, ticks, stop_every=TICKS_PER_STOP):
    """Number of ticks after which the images are given up; None if they are not."""
    for number in range(ticks):
        if stop_every and number % stop_every == 0:
            arrival.add_stop()
        arrival.on_tick()
        if arrival.is_given_up:
            return number + 1
    return None


def test_lost_images_are_given_up_after_stops_announced_again():
    assert wait(ScanArrival(), 100) == (SETTINGS.stops - 1) * TICKS_PER_STOP + 1  # 14.5 s


def test_an_image_begins_the_wait_anew():
    arrival = ScanArrival()
    for _ in range(20):
        assert wait(arrival, 3 * TICKS_PER_STOP) is None
        arrival.add_image()
    assert arrival.received == 20


def test_a_node_that_stood_still_has_not_waited():
    """However long it is stopped, it gets one tick, and the stops that came meanwhile at once."""
    arrival = ScanArrival()
    for _ in range(SETTINGS.stops - 2):
        arrival.add_stop()
        arrival.on_tick()
    for _ in range(50):
        arrival.add_stop()
    arrival.on_tick()
    assert not arrival.is_given_up
    arrival.add_image()
    arrival.on_tick()
    assert wait(arrival, 3 * TICKS_PER_STOP) is None


def test_a_collector_that_is_gone_is_not_waited_for_without_end():
    arrival = ScanArrival()
    arrival.add_stop()
    arrival.on_tick()
    assert wait(arrival, 100, stop_every=0) == SETTINGS.silent_ticks
