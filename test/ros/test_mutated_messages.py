# SPDX-License-Identifier: Apache-2.0
"""Messages with some bytes changed at random: refused in one line, or counted; never a crash."""

import random

import pytest
from fuzz.mutations import mutated
from kits.memory import limited_memory
from kits.own_messages import OWN_MESSAGES
from rclpy.serialization import deserialize_message, serialize_message

from stack_counter.errors import StackCounterError

TRIES = 300  # some 20,000 were run while this was written


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("kind", OWN_MESSAGES)
def test_what_is_changed_is_refused_or_used(kind):
    make, use = OWN_MESSAGES[kind]
    data, chance, outcomes = serialize_message(make()), random.Random(1), {"used": 0, "refused": 0}
    use(deserialize_message(data, kind))
    for _ in range(TRIES):
        try:
            message = deserialize_message(mutated(data, chance), kind)
        except Exception:  # the middleware drops it
            continue
        try:
            with limited_memory(100_000_000):
                use(message)
            outcomes["used"] += 1
        except StackCounterError as error:
            assert "\n" not in str(error)
            outcomes["refused"] += 1
    assert min(outcomes.values()) > TRIES / 20, outcomes
