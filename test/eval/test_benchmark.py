# SPDX-License-Identifier: Apache-2.0
"""The benchmark's figures."""

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from stack_counter.errors import ConfigError
from stack_counter.eval import benchmark
from stack_counter.eval.arguments import ADD_ARGUMENTS
from stack_counter.eval.common import cost
from stack_counter.types import Intrinsics

DATA = Path(__file__).parents[2] / "data" / "train-deep"
SMALL = Intrinsics(320, 240, 305.0, 305.0, 159.5, 119.5)


def test_figures_of_a_scene_are_finite(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(benchmark, "SETTINGS", replace(benchmark.SETTINGS, looped_voxels=500))
    monkeypatch.setattr(cost, "SETTINGS", replace(
        cost.SETTINGS, rounds=1, long_views=4, long_camera=SMALL))
    parser = argparse.ArgumentParser()
    ADD_ARGUMENTS["benchmark"](parser)
    out = tmp_path / "out.json"
    assert benchmark.run(parser.parse_args(
        ["--set", str(DATA), "--scenes", "1", "--views", "4", "--json", str(out)])) == 0
    figures = json.loads(out.read_text())
    assert len(figures["scenes"]) == 1
    numbers = [v for row in (*figures["scenes"], figures["cost"]) for v in row.values()
               if not isinstance(v, str)]
    assert all(map(math.isfinite, numbers))
    assert figures["cost"]["long_peak_mb"] > figures["cost"]["long_loaded_mb"] > 50
    assert "rule as released" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--set", "no-such-set"],
                                       ["--set", str(DATA), "--views", "3"]])
def test_what_cannot_be_measured_is_refused(arguments):
    parser = argparse.ArgumentParser()
    ADD_ARGUMENTS["benchmark"](parser)
    with pytest.raises(ConfigError):
        benchmark.run(parser.parse_args(arguments))
