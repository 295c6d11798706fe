# SPDX-License-Identifier: Apache-2.0
"""What a prompts file may hold."""

import json

import numpy as np
import pytest

from stack_counter.segmentation.prompts import PromptError, parse_prompts, read_prompts

TEXT = """
parts:
  boxes: [[10, 20, 30, 40], [12, 20, 38.5, 40]]
  points: [[15, 25]]
container: {boxes: [[5, 6, 70, 80]]}
background: {points: [[1, 2], [3, 4]]}
"""


def test_file_and_text_say_the_same(tmp_path):
    (tmp_path / "p.yaml").write_text(TEXT)
    prompts = read_prompts(str(tmp_path / "p.yaml"))
    assert prompts.part_boxes.tolist() == [[10, 20, 30, 40], [12, 20, 38.5, 40]]
    assert prompts.part_points.tolist() == [[15, 25]]
    assert prompts.container_boxes.tolist() == [[5, 6, 70, 80]]
    assert prompts.container_points.shape == (0, 2)
    assert prompts.background_points.tolist() == [[1, 2], [3, 4]]
    assert prompts.with_container
    inline = read_prompts(json.dumps({"parts": {"points": [[15, 25]]}}))
    assert inline.part_points.tolist() == [[15, 25]] and not inline.with_container


@pytest.mark.parametrize("text, said", [
    ("[1, 2]", "prompts are list; expected 'parts'"),
    ("", "prompts are NoneType"),
    ("part: {points: [[1, 2]]}", "unknown key 'part'; expected one of"),
    ("parts: [[1, 2]]", "'parts' is .* expected boxes or points"),
    ("parts: {dots: [[1, 2]]}", "unknown key 'dots' under 'parts'"),
    ("background: {boxes: [[1, 2, 3, 4]]}", "unknown key 'boxes' under 'background'"),
    ("parts: {points: [1, 2]}", "parts.points is .* expected a list of .2 numbers."),
    ("parts: {boxes: [[1, 2, 3]]}", "expected a list of .4 numbers."),
    ("parts: {points: [[1, .nan]]}", "expected a list of .2 numbers."),
    ("parts: {points: [[1, yes]]}", "expected a list of .2 numbers."),
    ("parts: {boxes: [[5, 2, 3, 4]]}", "expected x0 < x1 and y0 < y1"),
    ("container: {points: [[1, 2]]}", "no part is marked"),
    ("parts: [", "cannot be read as YAML"),
])
def test_what_is_wrong_is_named_in_one_line(tmp_path, text, said):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(PromptError, match=f"{path}.*{said}") as caught:
        read_prompts(str(path))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(PromptError, match="no prompts file .*none.yaml"):
        read_prompts(str(tmp_path / "none.yaml"))
    with pytest.raises(PromptError, match="cannot be read"):
        read_prompts(str(tmp_path))


def test_marks_lie_in_the_image():
    prompts = parse_prompts({"parts": {"boxes": [[0, 0, 640, 480]], "points": [[639.5, 0]]}})
    prompts.check(640, 480)
    with pytest.raises(PromptError, match=r"part_boxes \[0.*640.*is outside of the 639x480"):
        prompts.check(639, 480)
    with pytest.raises(PromptError, match="part_points"):
        parse_prompts({"parts": {"points": [[-1, 3]]}}).check(640, 480)


def test_scaled_marks_stay_on_what_they_show():
    """Pixel centres lie on whole numbers: the middle of two pixels is the middle of one."""
    prompts = parse_prompts({"parts": {"points": [[0.5, 2.5]], "boxes": [[-0.5, -0.5, 3.5, 7.5]]}})
    half = prompts.scaled(np.array([0.5, 0.5]))
    assert half.part_points.tolist() == [[0, 1]]
    assert half.part_boxes.tolist() == [[-0.5, -0.5, 1.5, 3.5]]
    assert half.container_boxes.shape == (0, 4)


def nested_lists(levels):
    """YAML whose lists hold the one before ten times each: 10 ** levels marks in a few lines."""
    lists = ["a0: &a0 [1]"] + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]"
                               for i in range(1, levels)]
    return "{" + ", ".join(lists) + "}"


@pytest.mark.parametrize("text, said", [
    (nested_lists(12), "expected each mark written out"),
    ("{parts: " + "[" * 5000 + "]" * 5000 + "}", "cannot be read as YAML"),
    ("{parts: {points: [[1, " + "9" * 5000 + "]]}}", "cannot be read as YAML"),
    ("{parts: {points: [[1, " + "9" * 400 + "]]}}", "expected a list of .2 numbers."),
    ("{parts: {points: [[2001-99-99, 2]]}}", "cannot be read as YAML")])
def test_a_text_by_parameter_that_would_take_memory_or_end_the_node_is_refused(text, said):
    with pytest.raises(PromptError, match=said) as caught:
        read_prompts(text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000
