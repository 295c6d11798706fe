# SPDX-License-Identifier: Apache-2.0
"""Readers of strangers' bytes take whole files, and refuse in one line what is no such file."""

import random
from pathlib import Path

import pytest
from fuzz.targets import TARGETS

FOUND = Path(__file__).parent / "found"
SLOW = {"step", "transforms"}  # of these each file takes half a second and more


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", TARGETS)
def test_whole_files_are_used_and_changed_ones_used_or_refused(name, tmp_path):
    target, chance = TARGETS[name], random.Random(7)
    if name == "step":
        pytest.importorskip("cascadio", reason="the extra 'cad' is not installed")
    whole = target.whole_files()[::4 if name in SLOW else 1]
    assert {target.outcome(data, tmp_path) for data in whole} == {"used"}
    for _ in range(1 if name in SLOW else 20):
        target.outcome(target.change(chance.choice(whole), chance), tmp_path)


@pytest.mark.parametrize("path", sorted(FOUND.glob("*/*")), ids=lambda path: "/".join(
    path.parts[-2:]))
def test_what_was_found_is_used_or_refused(path, tmp_path):
    """Each of these files raised an error of another kind, or took seconds and gigabytes."""
    TARGETS[path.parent.name].outcome(path.read_bytes(), tmp_path)
