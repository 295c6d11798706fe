# SPDX-License-Identifier: Apache-2.0
"""The messages between our nodes that carry most, small, and what uses them."""

from functools import lru_cache

import numpy as np
from stack_counter_msgs.msg import PosedImage, StackVolume

from stack_counter import geometry
from stack_counter.config import CounterConfig
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

CAMERA = Intrinsics(6, 4, 5.0, 5.0, 3.0, 2.0, "plumb_bob", (0.1,) * 5)
COLOR = np.random.default_rng(0).integers(0, 255, (4, 6, 3), np.uint8)
DEPTH, LABELS = np.full((4, 6), 0.5, np.float32), np.full((4, 6), 2, np.uint8)


def posed_image():
    return convert.to_posed_image(View(5, CAMERA, np.eye(4), COLOR, DEPTH, LABELS, "camera"),
                                  "world", "scan", PartRequest("nut", 1e-6))


def stack_volume():
    surface = HeightMap(np.eye(4), 0.01, np.ones((4, 5), np.float32))
    volume = Volume(0, 1e-3, 1e-5, Container("box", np.eye(4), (0.1, 0.1, 0.1)), (0, 0.5, 1), 1.0,
                    surface, surface, KeyView(0, CAMERA, np.eye(4), 3, LABELS, DEPTH, COLOR),
                    ViewTally(3, 3))
    return convert.to_stack_volume(volume, "world", posed_image(), True)


def use_view(message):
    """Does what the reconstructor does first."""
    geometry.rectify(convert.from_posed_image(message))


def use_volume(message):
    """Does what the counter does."""
    count = count_stack(convert.from_stack_volume(message), Part(1e-6), _estimator(), 0.9)
    convert.to_stack_count(count, message)


@lru_cache
def _estimator():
    return make_estimator(CounterConfig())


# What makes and what uses a message, by its type.
OWN_MESSAGES = {PosedImage: (posed_image, use_view), StackVolume: (stack_volume, use_volume)}
