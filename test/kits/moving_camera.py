# SPDX-License-Identifier: Apache-2.0
"""Messages of one moving camera, for tests of what becomes a view."""

from dataclasses import replace

import cv2
import numpy as np
from kits.recording_kit import camera_info, image, transform

from stack_counter import geometry
from stack_counter.config import CollectorConfig
from stack_counter.types import Intrinsics
from stack_counter.views.assembler import ViewAssembler

FRAME, MS = "camera_color_optical_frame", 1_000_000
CAMERA = Intrinsics(64, 48, 60.0, 61.0, 31.5, 23.5, "plumb_bob", (0.0,) * 5)
COLOR_ONLY = CollectorConfig(depth_topic="", min_sharpness=0.0)
WITH_DEPTH = replace(COLOR_ONLY, depth_topic="/depth")
METRES = np.full((CAMERA.height, CAMERA.width), 0.5, np.float32)


def picture(seed=0, k=CAMERA):
    """(h, w, 3) uint8 RGB with edges in it, another for each seed."""
    coarse = np.random.default_rng(seed).integers(0, 255, (8, 8, 3), np.uint8)
    return cv2.resize(coarse, (k.width, k.height), interpolation=cv2.INTER_NEAREST)


def camera_pose(i):
    """The i-th pose of a camera that moves 2 cm and turns a little between views."""
    return geometry.look_at(np.array([0.02 * i - 0.1, 0.3, 0.5]), np.zeros(3))


def stamp_of(i):
    return (i + 1) * 100 * MS


def add_tf(assembler, i, offsets_ms=(-20, 20)):
    for offset in offsets_ms:
        assembler.add_transform(
            transform(stamp_of(i) + offset * MS, camera_pose(i)), False)


def feed(assembler, i, color=None, info=None, depth=METRES, tf=True):
    """All messages of the i-th view, at one stamp; depth is ignored where none is expected."""
    stamp = stamp_of(i)
    assembler.add_camera_info(camera_info(CAMERA, stamp) if info is None else info)
    assembler.add_color(image(picture(i), "rgb8", stamp) if color is None else color)
    if depth is not None:
        assembler.add_depth(image(depth, "32FC1", stamp) if isinstance(depth, np.ndarray)
                            else depth)
    if tf:
        add_tf(assembler, i)


def collected(config, *faulty, **fault):
    """Views and tally of four images, with one fault in those listed."""
    assembler, views = ViewAssembler(config, live=False), []
    for i in range(4):
        feed(assembler, i, **(fault if i in faulty else {}))
        views += assembler.poll()
    return views + assembler.flush(), assembler


def check_skip(reason, config, **fault):
    """One faulty image among four is skipped with its reason, on one line; the others count."""
    views, assembler = collected(config, 1, **fault)
    assert assembler.tally.skipped == {reason: 1}
    assert (assembler.tally.received, assembler.tally.used) == (4, 3)
    assert [v.stamp_ns for v in views] == [stamp_of(i) for i in (0, 2, 3)]
    text = assembler.last_error[reason]
    assert "\n" not in text
    return text
