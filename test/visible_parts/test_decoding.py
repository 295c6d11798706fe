# SPDX-License-Identifier: Apache-2.0
"""Parts are decoded from outputs that are laid out by hand."""

import numpy as np
import pytest

from stack_counter.occupancy.maps import PIXELS_PER_LENGTH
from stack_counter.visible_parts.decoding import (
    COLS,
    MIDDLE,
    OUTPUTS,
    ROWS,
    SHARE,
    SHOWN,
    decode_parts,
)

SHAPE = (40, 60)


def blank():
    """Outputs of nothing that shows, and a mask that is valid everywhere."""
    output = np.zeros((OUTPUTS, *SHAPE), np.float32)
    output[[SHOWN, MIDDLE]] = -8
    return output, np.ones(SHAPE, bool)


def lay(output, rows, cols, share, score, votes_for=None):
    """Lays a rectangle of pixels that vote for its middle, or for `votes_for`."""
    row, col = votes_for or ((rows.start + rows.stop - 1) / 2, (cols.start + cols.stop - 1) / 2)
    here = np.mgrid[rows, cols]
    output[SHOWN, rows, cols] = 4
    output[SHARE, rows, cols] = np.log(share / (1 - share))
    output[ROWS, rows, cols] = (row - here[0]) / PIXELS_PER_LENGTH
    output[COLS, rows, cols] = (col - here[1]) / PIXELS_PER_LENGTH
    output[MIDDLE, round(row), round(col)] = np.log(score / (1 - score))


def test_rectangles_are_found_with_middle_share_score_and_outline():
    output, valid = blank()
    lay(output, slice(4, 13), slice(5, 20), 0.9, 0.6)
    lay(output, slice(13, 20), slice(5, 20), 0.4, 0.8)  # touches the first
    parts = decode_parts(output, valid)
    assert parts.scores == pytest.approx([0.8, 0.6])
    assert parts.shares == pytest.approx([0.4, 0.9], abs=1e-5)
    assert parts.centers == pytest.approx(np.array([[16, 12], [8, 12]]))
    assert np.bincount(parts.numbers[parts.numbers >= 0]).tolist() == [7 * 15, 9 * 15]
    outline = parts.outlines()[1]
    assert outline.min(axis=0).tolist() == [4, 5] and outline.max(axis=0).tolist() == [12, 19]


def test_a_part_in_two_pieces_is_one():
    output, valid = blank()
    lay(output, slice(10, 14), slice(5, 15), 0.5, 0.7, votes_for=(11.5, 20.0))
    lay(output, slice(10, 14), slice(26, 36), 0.5, 0.7, votes_for=(11.5, 20.0))
    parts = decode_parts(output, valid)
    assert len(parts.scores) == 1
    assert parts.centers[0] == pytest.approx([11.5, 20])
    assert len(parts.outlines()) == 1


def test_what_votes_for_no_middle_or_too_few_is_left_out():
    output, valid = blank()
    lay(output, slice(4, 13), slice(5, 14), 0.9, 0.6)
    output[SHOWN, 30:35, 40:50] = 4  # pixels without a middle
    output[MIDDLE, 35, 10] = 4  # a middle without pixels
    parts = decode_parts(output, valid)
    assert len(parts.scores) == 1
    assert (parts.numbers[30:35, 40:50] == -1).all()


def test_nothing_is_told_below_the_threshold_or_where_it_is_not_valid():
    output, valid = blank()
    lay(output, slice(4, 13), slice(5, 14), 0.9, 0.6)
    assert len(decode_parts(output, valid, 0.7).scores) == 0
    assert decode_parts(output, valid, 0.7).outlines() == []
    assert len(decode_parts(output, np.zeros(SHAPE, bool)).scores) == 0
