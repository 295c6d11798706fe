# SPDX-License-Identifier: Apache-2.0
"""The metrics of `stack_counter.eval.images` on answers that are known exactly."""

import argparse
import json

import numpy as np
import pytest

from stack_counter.eval import images
from stack_counter.eval.arguments import ADD_ARGUMENTS
from stack_counter.eval.images import (
    DepthErrors,
    PictureErrors,
    measure_depth_errors,
    summarise_errors,
)
from stack_counter.types import BACKGROUND, PARTS, Intrinsics, View


def view(depth):
    labels = np.full((2, 4), PARTS, np.uint8)
    labels[:, 3] = BACKGROUND
    return View(1, Intrinsics(4, 2, 5.0, 5.0, 1.5, 0.5), np.eye(4), depth=depth, labels=labels)


TRUTH = np.full((2, 4), 0.5, np.float32)


def test_perfect_depth_has_no_error():
    assert measure_depth_errors([view(TRUTH)], [view(TRUTH)]) == DepthErrors(0.0, 0.0, 1.0, 1.0)


def test_one_miss_and_one_error_count_once_each():
    depth = TRUTH.copy()
    depth[0, 0], depth[0, 1], depth[0, 3] = 0, 0.51, 9  # the last is no part
    assert measure_depth_errors([view(depth)], [view(TRUTH)]) == DepthErrors(
        0.0, 0.0, 5 / 6, 4 / 6
    )


def test_a_shift_is_a_bias():
    found = measure_depth_errors([view(TRUTH + np.float32(0.002))], [view(TRUTH)])
    assert (found.median_m, found.bias_m) == pytest.approx((0.002, 0.002), abs=1e-6)


def test_nothing_known_is_not_zero_error():
    found = measure_depth_errors([view(np.zeros_like(TRUTH))], [view(TRUTH)])
    assert np.isnan(found.median_m) and (found.known, found.right) == (0, 0)


def row(kind, error, hull, depth=None):
    return PictureErrors(0, kind, kind, (), depth,
               {"pictures": error, "hull": hull, "ideal_depth": None})


def test_errors_are_summed_up_by_source_and_kind():
    depth = DepthErrors(0.001, 0.0, 0.8, 0.6)
    summary = summarise_errors([row("bin", 0.1, 1.0, depth), row("bin", -0.1, 2.0, depth),
                         row("none", 0.3, None)])
    assert summary["pictures, all"] == pytest.approx(
        {"mean_abs": 0.5 / 3, "bias": 0.1, "p95": 0.28, "scenes": 3})
    assert summary["pictures, bin"]["bias"] == pytest.approx(0)
    assert summary["hull, all"] == pytest.approx(
        {"mean_abs": 1.5, "bias": 1.5, "p95": 1.95, "scenes": 2})
    assert "hull, none" not in summary and "ideal_depth, all" not in summary
    assert summary["depth"]["known"] == pytest.approx(0.8)


def test_the_command_writes_what_it_found(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(images, "read_scenes", lambda folder: iter("abc"))
    monkeypatch.setattr(images, "record", lambda scene, *how, **more: [])
    monkeypatch.setattr(images, "evaluate_pictures", lambda scene, views: row(scene, 0.1, 1.0))
    parser = argparse.ArgumentParser()
    ADD_ARGUMENTS["images"](parser)
    out = tmp_path / "out.json"
    options = ["--set", str(tmp_path), "--scenes", "2", "--json", str(out)]
    assert images.run(parser.parse_args(options)) == 0
    result = json.loads(out.read_text())
    assert [scene["kind"] for scene in result["scenes"]] == ["a", "b"]
    assert result["summary"]["pictures, all"]["mean_abs"] == pytest.approx(0.1)
    assert "pictures, all: mean_abs 0.1" in capsys.readouterr().out
