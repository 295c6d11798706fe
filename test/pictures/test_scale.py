# SPDX-License-Identifier: Apache-2.0
"""Scale by references in closed form: exact marks give it exactly, noise gives its own error."""

import cv2
import numpy as np
import pytest
from kits.uncalibrated import UNIT, cameras, marks, marks_text, pictures_of

from stack_counter.errors import BagError
from stack_counter.pictures.reference import parse_reference
from stack_counter.pictures.scale import measure_scale
from stack_counter.pictures.targets import RigidTarget, find_targets

A, B = np.array([-0.1, 0.05, 0.0]), np.array([0.1, -0.05, 0.03])
LENGTH = float(np.linalg.norm(B - A))


def measured(text, seen, read_gray=None):
    reference = parse_reference(text)
    sizes = {name: (640, 480) for name in seen}
    return measure_scale([(reference, find_targets(reference, sizes, read_gray))], seen)


@pytest.mark.parametrize("distortion", [(), (-0.1, 0.02, 0.0, 0.0, 0.0)])
def test_exact_marks_give_the_scale(distortion):
    seen = cameras(distortion=distortion)
    scale = measured(f"{marks_text(A, seen)} to {marks_text(B, seen)} = {LENGTH}", seen)
    assert scale.metres == pytest.approx(UNIT, rel=1e-4)
    # Half a millimetre of 226, and marks within a pixel of half a metre away, six of each end.
    assert 0.0022 < scale.relative_std < 0.005


def test_the_error_is_that_of_noisy_marks():
    seen, random = cameras(), np.random.default_rng(0)
    errors, said = [], []
    for _ in range(100):
        target = RigidTarget("it", np.array([[0, 0, 0], [LENGTH, 0, 0]]), [
            marks(point, seen, 1.5, random) for point in (A, B)], 1.0)
        scale = measure_scale([(parse_reference("aruco DICT_4X4_50 = 100"), [target])], seen)
        errors.append(np.log(scale.metres / UNIT))
        said.append(scale.relative_std)
    assert np.std(errors) == pytest.approx(np.sqrt(np.mean(np.square(said))), rel=0.25)
    assert abs(np.mean(errors)) < 3 * np.std(errors) / 10


def test_a_board_gives_the_scale_within_a_thousandth():
    seen = cameras()
    board = cv2.aruco.CharucoBoard((7, 5), 0.03, 0.0225, cv2.aruco.getPredefinedDictionary(
        cv2.aruco.DICT_5X5_100))
    pictures = pictures_of(board.generateImage((1400, 1000)), (0.21, 0.15), seen)
    scale = measured("charuco DICT_5X5_100 7x5 0.0225 = 0.03", seen, pictures.__getitem__)
    assert scale.metres == pytest.approx(UNIT, rel=1e-3)
    markers = measured("aruco DICT_5X5_100 = 0.0225", seen, pictures.__getitem__)
    assert abs(np.log(markers.metres / UNIT)) < 2 * markers.relative_std < 0.06


def test_a_mark_of_another_point_is_named():
    seen = cameras()
    wrong = marks_text(A, seen).replace(marks_text(A, {"p2.png": seen["p2.png"]}), "p2.png:20,20")
    with pytest.raises(BagError, match="in p2.png lies .* pixels beside"):
        measured(f"{wrong} to {marks_text(B, seen)} = {LENGTH}", seen)


def test_too_little_to_go_by_is_refused():
    seen = cameras()
    two = dict(list(seen.items())[:2])
    one = {"p0.png": seen["p0.png"]}
    text = f"{marks_text(A, two)} to {marks_text(B, two)} = {LENGTH}"
    reference = parse_reference(text)
    targets = find_targets(reference, {name: (640, 480) for name in two}, lambda name: None)
    with pytest.raises(BagError, match="0 points .* p1.png did not register"):
        measure_scale([(reference, targets)], one)
    near = B * 0.02 + A * 0.98
    with pytest.raises(BagError, match="gives the scale within .*; expected 5%: take a longer"):
        measured(f"{marks_text(A, seen)} to {marks_text(near, seen)} = {LENGTH * 0.02}", seen)
    same = {"p0.png": seen["p0.png"], "p1.png": seen["p0.png"]}
    with pytest.raises(BagError, match="one direction; expected pictures taken from apart"):
        measured(f"{marks_text(A, same)} to {marks_text(B, same)} = {LENGTH}", same)


def test_references_that_disagree_are_refused_and_those_that_agree_are_joined():
    seen = cameras()

    def by(*factors):
        references = [parse_reference(f"{marks_text(A, seen)} to {marks_text(B, seen)} = "
                                      f"{LENGTH * factor}") for factor in factors]
        sizes = {name: (640, 480) for name in seen}
        return measure_scale([(r, find_targets(r, sizes, lambda name: None)) for r in references],
                             seen)

    assert by(1.0, 1.0).relative_std < by(1.0).relative_std
    assert by(0.99, 1.01).metres == pytest.approx(UNIT, rel=1e-3)
    assert by(0.99, 1.01).relative_std == pytest.approx(0.01, rel=0.2)  # they differ by more
    with pytest.raises(BagError, match="expected all within 5%"):
        by(1.0, 1.1)
