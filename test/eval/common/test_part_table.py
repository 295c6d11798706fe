# SPDX-License-Identifier: Apache-2.0
"""Tables of what knowing the part brings."""

import numpy as np
import pytest
from kits.known_parts import gamma_model

from stack_counter.eval.common.part_table import (
    ROWS,
    PartCount,
    Rig,
    format_sensitivity,
    format_table,
)
from stack_counter.parts.part_models import PartModels

RIG = Rig(0, "knob", 3, "bin", 0.4, [])


def test_the_figures_are_those_of_the_answers():
    answers = [PartCount(row, 0, i, 100, 100 + 5 * i, 90, 110, 0.5, ()) for row in ROWS
               for i in range(5)]
    line = next(line for line in format_table([RIG], answers, 0).splitlines()
                if line.startswith("CAD  "))
    assert [float(x) for x in line.split()[1:]] == pytest.approx(
        [5, 0.1, 0.1, 0.1, 1.0, 10 / 110, 0.5], abs=2e-3)


def test_the_sensitivity_is_that_of_the_models():
    made = PartModels("n", gamma_model(), gamma_model(), "piles")
    text = format_sensitivity([made, made])
    assert f"{np.exp(-0.03) - 1:+.1%}" in text and "+0.0%" in text
