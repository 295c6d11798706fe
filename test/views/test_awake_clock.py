# SPDX-License-Identifier: Apache-2.0
"""The clock of a process that may stand still."""

import pytest

from stack_counter.views.awake_clock import SETTINGS, AwakeClock


def test_time_passes_while_it_is_asked_for_and_not_while_the_process_stands_still():
    now = [50.0]
    clock = AwakeClock(lambda: now[0])
    for _ in range(20):
        now[0] += 0.1
        clock()
    assert clock() == pytest.approx(2.0)
    now[0] += 3600.0
    assert clock() == pytest.approx(2.0 + SETTINGS.max_step_s)
    assert clock() == clock()
