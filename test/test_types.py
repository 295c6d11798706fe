# SPDX-License-Identifier: Apache-2.0
"""Reasons and their page, tallies, and what a volume derives from its fields."""

import ast
import copy
import importlib.util
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from stack_counter.types import (
    Container,
    Intrinsics,
    Reason,
    StackVolume,
    View,
    ViewTally,
    spread_views,
)

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "stack_counter"
# Where slugs stand as strings: where they are defined, and a key of model files.
ALLOWED = {"types/reasons.py": {reason.value for reason in Reason},
           "parts/part_models.py": {"one_side"}}


def stack_volume(**fields):
    return StackVolume(0, 1e-3, 0.0, Container("none", np.eye(4)), (0.0, 0.0, 0.0), 1.0,
                       None, None, None, ViewTally(), **fields)


def test_a_reason_is_its_slug_everywhere():
    reason = Reason.NO_DEPTH
    assert str(reason) == f"{reason}" == "%s" % reason == reason.value == "no_depth"  # noqa: UP031
    assert reason == "no_depth" and "no_depth" in (reason,) and json.dumps([reason]) \
        == '["no_depth"]'
    assert Reason("no_depth") is reason is pickle.loads(pickle.dumps(reason)) \
        is copy.deepcopy(reason)


def test_an_unknown_reason_keeps_its_slug_and_does_not_degrade():
    unknown = Reason("of_a_newer_node")
    assert str(unknown) == "of_a_newer_node" and not unknown.degrades and unknown.sentence
    assert {unknown} == {Reason("of_a_newer_node")} and unknown not in list(Reason)
    assert pickle.loads(pickle.dumps(unknown)) == unknown
    with pytest.raises(ValueError):
        Reason(7)


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_has_a_sentence_of_what_was_seen_and_what_to_do(reason):
    assert reason.name.lower() == reason.value
    seen, _, action = reason.sentence.rpartition("; ")
    assert seen[:1].isupper() or seen.startswith("gamma")
    assert action.endswith(".") and "\n" not in reason.sentence


def test_the_page_of_reasons_is_that_of_the_enum():
    script = ROOT / "scripts" / "reasons_page.py"
    spec = importlib.util.spec_from_file_location("reasons_page", script)
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    assert page.PAGE.read_text() == page.reasons_page(), "run python scripts/reasons_page.py"


def test_code_names_reasons_by_the_enum():
    """A slug as a string escapes the type checker; skipped views have slugs of their own."""
    slugs, found = {reason.value for reason in Reason}, {}
    for path in PACKAGE.rglob("*.py"):
        tree, name = ast.parse(path.read_text()), path.relative_to(PACKAGE).as_posix()
        skipped = {id(node) for call in ast.walk(tree) if isinstance(call, ast.Call)
                   and getattr(call.func, "id", "") == "ViewError" for node in ast.walk(call)}
        found[name] = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)
                       and isinstance(node.value, str) and id(node) not in skipped} & slugs
    assert {name: used for name, used in found.items() if used} == ALLOWED


def test_tallies_of_stages_in_a_row_add_up():
    collected = ViewTally(12, 10, {"blurred": 1, "no_tf": 1})
    fused = ViewTally(10, 8, {"empty_depth": 1, "no_tf": 1})
    assert collected + fused == ViewTally(12, 8, {"blurred": 1, "no_tf": 2, "empty_depth": 1})


def test_missing_cameras_are_a_reason():
    whole = stack_volume()
    assert whole.with_missing_cameras([]).reasons == ()
    lacking = whole.with_missing_cameras(["left"])
    assert lacking.missing_cameras == ("left",) and lacking.reasons == (Reason.CAMERA_MISSING,)


@pytest.mark.parametrize(("number", "most", "chosen"), [
    (0, 3, []), (1, 3, [0]), (2, 3, [0, 1]), (7, 3, [0, 3, 6]), (7, 1, [0]), (4, 3, [0, 2, 3])])
def test_views_are_spread_over_all(number, most, chosen):
    views = [View(stamp, Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0), np.eye(4))
             for stamp in range(number)]
    assert [view.stamp_ns for view in spread_views(views, most)] == chosen
