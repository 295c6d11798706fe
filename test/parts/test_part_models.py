# SPDX-License-Identifier: Apache-2.0
"""A part's models survive their file; another file is refused."""

import re

import numpy as np
import pytest
from kits.known_parts import gamma_model

from stack_counter.errors import PartError
from stack_counter.parts.gamma_model import Reading
from stack_counter.parts.part_models import PartModels, read_models

SCAN = Reading(3.0, 6.0, np.log(0.5))


def test_models_survive_a_file(tmp_path):
    path = tmp_path / "parts" / "a.json"
    made = PartModels("network 7", gamma_model(), gamma_model(0.2), "64 piles")
    made.write(path)
    again = read_models(path)
    assert (again.estimator, again.made) == ("network 7", "64 piles")
    assert again.one_side.posterior(SCAN).std == pytest.approx(made.one_side.posterior(SCAN).std,
                                                             rel=1e-4)


@pytest.mark.parametrize("text", ["", "{}", '{"format": "other"}', "[1]", "\x00"])
def test_another_file_is_refused(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(PartError, match="is no gamma prior"):
        read_models(path)
    with pytest.raises(PartError, match="no gamma prior"):
        read_models(tmp_path / "none.json")


@pytest.mark.parametrize("number, said", [
    ("NaN", "NaN or infinite"), ("1" + "0" * 400, "int too large"), ("[" * 100_000, "recursion")])
def test_a_prior_of_numbers_that_are_none_is_refused(number, said, tmp_path):
    path = tmp_path / "a.json"
    PartModels("network 7", gamma_model(), gamma_model(0.2), "64 piles").write(path)
    path.write_text(re.sub('(?<="volume_variance": )[^,}]+', number, path.read_text(), count=1))
    with pytest.raises(PartError, match=f"is no gamma prior: .*{said}"):
        read_models(path)
