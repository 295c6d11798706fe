# SPDX-License-Identifier: Apache-2.0
"""Streams and calibrations: which one belongs to a stamp, checked against a plain search."""

import numpy as np
import pytest

from stack_counter.errors import ViewError
from stack_counter.types import Intrinsics
from stack_counter.views.image_stream import MAX_QUEUED_MESSAGES, Calibrations, ImageStream

TOLERANCE = 5
COLOR = np.zeros((2, 3, 3), np.uint8)


def image(value):
    return np.full((2, 3), value, np.float32)


def stream_of(*stamps):
    stream = ImageStream("depth", TOLERANCE)
    for stamp in stamps:
        stream.add(stamp, image(stamp))
    return stream


def test_the_nearest_image_is_that_of_a_plain_search_in_any_order_of_arrival():
    random = np.random.default_rng(0)
    for _ in range(50):
        stamps = random.choice(200, 20, replace=False)
        stream, wanted = stream_of(*stamps), int(random.integers(200))
        nearest = min(sorted(stamps), key=lambda s: abs(s - wanted))
        if abs(nearest - wanted) > TOLERANCE:
            with pytest.raises(ViewError, match="unsynchronised"):
                stream.nearest_image(COLOR, wanted, "bad_depth")
        else:
            found = stream.nearest_image(COLOR, wanted, "bad_depth")[0, 0]
            assert abs(found - wanted) == abs(nearest - wanted)


def test_an_image_is_settled_once_one_at_or_after_its_stamp_has_come():
    assert not stream_of().is_settled(1)
    assert [stream_of(5, 7).is_settled(t) for t in (4, 7, 8)] == [True, True, False]


def test_only_what_a_later_image_can_use_is_kept():
    stream = stream_of(10, 20, 30)
    stream.forget_before(25)  # 20 lies within the tolerance of 25
    assert stream.nearest_image(COLOR, 20, "bad_depth")[0, 0] == 20
    with pytest.raises(ViewError, match=r"nearest \+0.0 ms"):
        stream.nearest_image(COLOR, 10, "bad_depth")
    many = stream_of(*range(0, 100 * TOLERANCE, TOLERANCE))
    first_kept = TOLERANCE * (100 - MAX_QUEUED_MESSAGES)
    assert many.nearest_image(COLOR, first_kept, "bad_depth")[0, 0] == first_kept
    with pytest.raises(ViewError, match="unsynchronised"):
        many.nearest_image(COLOR, first_kept - 2 * TOLERANCE, "bad_depth")


def test_a_clock_set_back_forgets_what_is_later():
    stream = stream_of(10, 100, 200)
    stream.restart(50)
    assert not stream.is_settled(11)


def test_another_size_and_an_image_that_did_not_decode_are_errors_of_their_own():
    stream = ImageStream("labels", TOLERANCE)
    stream.add(1, ViewError("bad_encoding", "no"))
    stream.add(100, np.zeros((4, 4), np.uint8))
    for stamp, reason in ((1, "bad_encoding"), (100, "bad_labels")):
        with pytest.raises(ViewError) as caught:
            stream.nearest_image(COLOR, stamp, "bad_labels")
        assert caught.value.reason == reason


def calibration(fx):
    return Intrinsics(3, 2, fx, fx, 1.0, 0.5)


def test_a_calibration_holds_from_its_stamp_on_and_the_first_one_always():
    calibrations = Calibrations(TOLERANCE)
    assert not calibrations and calibrations.calibration_at(0) is None
    for stamp, fx in ((100, 1.0), (200, 1.0), (300, 2.0)):
        calibrations.add(stamp, calibration(fx))
    found = [calibrations.calibration_at(t).fx for t in (0, 150, 294, 295, 1000)]
    assert found == [1.0, 1.0, 1.0, 2.0, 2.0]
    calibrations.restart()
    assert calibrations.calibration_at(0).fx == 2.0


def test_a_calibration_sent_with_every_image_is_waited_for_and_one_sent_once_is_not():
    with_images, once = Calibrations(TOLERANCE), Calibrations(TOLERANCE)
    with_images.add(100, calibration(1.0))
    once.add(10, calibration(1.0))
    for calibrations in (with_images, once):
        calibrations.note_decided(100)
    assert not with_images.is_settled(200) and once.is_settled(200)
