# SPDX-License-Identifier: Apache-2.0
"""Messages with some bytes changed at random: refused in one line, or counted; never a crash."""

import random

import numpy as np
import pytest
from kits.memory import limited_memory
from rclpy.serialization import deserialize_message, serialize_message
from stack_counter_msgs.msg import PosedImage, StackVolume

from stack_counter import geometry
from stack_counter.config import CounterConfig
from stack_counter.errors import StackCounterError
from stack_counter.occupancy import make_estimator
from stack_counter.parts.catalogue import Part
from stack_counter.ros import conversions as convert
from stack_counter.stack_count import count_stack
from stack_counter.types import (
    Container,
    HeightMap,
    Intrinsics,
    KeyView,
    PartRequest,
    View,
    ViewTally,
)
from stack_counter.types import StackVolume as Volume

TRIES = 300  # some 20,000 were run while this was written
CAMERA = Intrinsics(6, 4, 5.0, 5.0, 3.0, 2.0, "plumb_bob", (0.1,) * 5)
COLOR = np.random.default_rng(0).integers(0, 255, (4, 6, 3), np.uint8)
DEPTH, LABELS = np.full((4, 6), 0.5, np.float32), np.full((4, 6), 2, np.uint8)
ODD = [float("nan"), float("inf"), -1.0, 1e300, 1e-300]


def posed_image():
    return convert.to_posed_image(View(5, CAMERA, np.eye(4), COLOR, DEPTH, LABELS, "camera"),
                                  "world", "scan", PartRequest("nut", 1e-6))


def stack_volume():
    surface = HeightMap(np.eye(4), 0.01, np.ones((4, 5), np.float32))
    volume = Volume(0, 1e-3, 1e-5, Container("box", np.eye(4), (0.1, 0.1, 0.1)), (0, 0.5, 1), 1.0,
                    surface, surface, KeyView(0, CAMERA, np.eye(4), 3, LABELS, DEPTH, COLOR),
                    ViewTally(3, 3))
    return convert.to_stack_volume(volume, "world", posed_image(), True)


def mutated(data, chance):
    """The bytes with one to four numbers in them replaced."""
    changed = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 4])):
        width, at = chance.choice([1, 4, 8]), chance.randrange(4, len(data))
        value = chance.choice([bytes([chance.randrange(256)]) * width, b"\xff" * width,
                               b"\0" * width, np.float64(chance.choice(ODD)).tobytes()[:width]])
        changed[at:at + len(value)] = value
    return bytes(changed)


def use_view(message):
    geometry.rectify(convert.from_posed_image(message))


@pytest.fixture(scope="module")
def estimator():
    return make_estimator(CounterConfig())


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("kind", [PosedImage, StackVolume])
def test_what_is_changed_is_refused_or_used(kind, estimator):
    def use_volume(message):
        count = count_stack(convert.from_stack_volume(message), Part(1e-6), estimator, 0.9)
        convert.to_stack_count(count, message)

    use, make = (use_view, posed_image) if kind is PosedImage else (use_volume, stack_volume)
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
