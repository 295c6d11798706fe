# SPDX-License-Identifier: Apache-2.0
"""Guesses of people, numbers in answers, pictures brought into squares."""

import json

import numpy as np
import pytest

from stack_counter.errors import ConfigError, WeightsError
from stack_counter.picture_baselines import KINDS, load_baseline
from stack_counter.picture_baselines.people import People
from stack_counter.picture_baselines.picture import Picture, fit_square, normalized
from stack_counter.picture_baselines.vision_language import first_integer


def picture(scene="pasta", shape=(40, 60, 3), seed=0):
    color = np.random.default_rng(seed).integers(0, 255, shape, np.uint8)
    return Picture(scene, color, "nut", np.array([[5, 5, 20, 20.0], [30, 5, 45, 22]]))


@pytest.mark.parametrize("text", ["pasta: [200, 230]\nbricks: 80\n3: 7",
                                  json.dumps({"pasta": [200, 230], "bricks": 80, "3": 7})])
def test_guesses_are_found_by_the_scene(tmp_path, text):
    path = tmp_path / "guesses.yaml"
    path.write_text(text)
    people = load_baseline("human", [path])
    assert people.guess(picture("pasta")) == [200, 230]
    assert people.guess(picture("bricks")) == [80] and people.guess(picture("3")) == [7]
    assert people.guess(picture("nobody was asked")) == []


@pytest.mark.parametrize("text, said", [
    ("[1, 2]", "holds a list; expected scenes"), ("pasta: many", "the guess 'many'; expected"),
    ("pasta: [0]", "the guess 0; expected numbers above 0"), ("pasta: true", "the guess True"),
    ("a: [", "cannot be read"), (None, "cannot be read")])
def test_a_file_that_holds_no_guesses_is_refused(tmp_path, text, said):
    path = tmp_path / "guesses.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        People(path)


@pytest.mark.parametrize("answer, number", [
    ("There are about 1,250 nuts.", 1250), ("42", 42), ("I see 3 rows of 12.", 3),
    ("12,34", 12), ("none", None), ("", None), ("around 588.", 588)])
def test_the_first_whole_number_of_an_answer(answer, number):
    assert first_integer(answer) == number


def test_a_picture_in_a_square_keeps_its_proportions():
    color = np.zeros((20, 40, 3), np.uint8)
    color[:, 20:] = 200
    square = fit_square(color, 80)
    assert square.color.shape == (80, 80, 3) and square.scale == 2
    assert not square.color[:20].any() and not square.color[60:].any()
    assert (square.color[22:58, 42:] == 200).all() and not square.color[20:60, :38].any()
    # A pixel's middle stays in the middle of what it became.
    np.testing.assert_allclose(square.moved(np.array([[0.0, 0], [39, 19]])),
                               [[0.5, 20.5], [78.5, 58.5]])


def test_normalised_colours_have_their_channels_first():
    values = normalized(np.full((2, 4, 6, 3), 255, np.uint8))
    assert values.shape == (2, 3, 4, 6) and values.dtype == np.float32
    assert values[0, 0, 0, 0] == pytest.approx((1 - 0.485) / 0.229)


@pytest.mark.parametrize("name", KINDS)
def test_the_files_that_a_baseline_needs_are_told(name):
    with pytest.raises(WeightsError, match=f"{name} got 0 paths .*; expected a "):
        load_baseline(name, [])
