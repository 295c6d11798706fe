# SPDX-License-Identifier: Apache-2.0
"""What a scene of 3DC-Real states of its parts."""

import pytest

from stack_counter.bag.nerfstudio.stacking import SceneFacts, read_facts
from stack_counter.errors import BagError


def test_a_scene_without_facts_states_none(tmp_path):
    assert read_facts(tmp_path) == SceneFacts()


@pytest.mark.parametrize("text, said", [
    ('{"gt_count": Infinity}', "malformed .cannot convert float infinity"),
    ('{"unit_volume": 1' + "0" * 400 + "}", "malformed .int too large"),
    ('{"human_guesses": 5}', "a list of them"), ("[" * 100_000, "maximum recursion depth")])
def test_facts_that_are_no_numbers_are_named(text, said, tmp_path):
    (tmp_path / "info.json").write_text(text)
    with pytest.raises(BagError, match=said):
        read_facts(tmp_path)
