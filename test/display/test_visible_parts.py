# SPDX-License-Identifier: Apache-2.0
"""The parts that show: in JSON by its schema, in words, and in the key view of the report."""

import json
from dataclasses import replace

import numpy as np
import pytest
from kits.counted_bin import counted_bin, key_view
from kits.result_schema import read_result

from stack_counter.display.report import as_dict, as_text, write_report
from stack_counter.display.visible_parts import outlines_in_view
from stack_counter.types import PartPose, VisiblePart

SQUARE = np.array([[-0.03, -0.03, 0.1], [0.03, -0.03, 0.1], [0.03, 0.03, 0.1],
                   [-0.03, 0.03, 0.1]])
PART = VisiblePart(np.array([0.0, 0.0, 0.1]), SQUARE, 0.9, 0.75)


def with_parts(*parts):
    return replace(counted_bin(), visible_parts=parts)


def test_json_has_their_number_and_places_or_null():
    result = read_result(json.dumps(as_dict(with_parts(PART, PART), [])))
    assert result["visible_count"] == 2
    assert result["visible_parts"][1] == {
        "position_m": [0, 0, 0.1], "outline_m": SQUARE[:, :2].tolist(), "share_visible": 0.9,
        "score": 0.75, "pose": None}
    none = read_result(json.dumps(as_dict(counted_bin(), [])))
    assert none["visible_count"] is None and none["visible_parts"] is None
    assert read_result(json.dumps(as_dict(with_parts(), [])))["visible_parts"] == []


def test_json_has_the_pose_of_a_part_that_has_one():
    T = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]], float)
    posed = replace(PART, pose=PartPose(T, 0.625))
    result = read_result(json.dumps(as_dict(with_parts(posed), [])))
    assert result["visible_parts"][0]["pose"] == {
        "position_m": [0.1, 0.2, 0.3], "quaternion_xyzw": [0, 0, 0.70711, 0.70711], "fit": 0.625}


def test_words_say_what_is_seen_and_what_is_inferred():
    count = with_parts(PART)
    assert f"1 part seen from above, {count.count - 1} inferred below" in as_text(count, None)
    assert "seen from above" not in as_text(counted_bin(), None)


def test_an_outline_lies_in_the_view_where_it_is_in_the_world():
    """The camera looks straight down from 0.6 m: 60 mm at 0.5 m take 24 pixels of 200 px / m."""
    (outline,) = outlines_in_view([PART], key_view())
    assert np.ptp(outline, axis=0) == pytest.approx([24, 24])
    assert outline.mean(axis=0) == pytest.approx([79.5, 59.5])
    behind = replace(PART, outline=SQUARE + [0, 0, 1])
    assert outlines_in_view([behind], key_view()) == []


def test_the_report_draws_them_into_the_key_view(tmp_path):
    for parts, drawn in ((None, 0), ((), 0), ((PART, PART), 2)):
        write_report(tmp_path, replace(counted_bin(), visible_parts=parts), [])
        page = (tmp_path / "report.html").read_text()
        assert page.count("<polygon points=") == drawn
        assert ('id="parts"' in page) == bool(drawn)
        assert ("Of the count" in page) == (parts is not None)
