# SPDX-License-Identifier: Apache-2.0
"""`replay` of a row of bins with a named region round each: a table and a list of results."""

import json

import pytest
import yaml
from kits.command import run
from kits.result_schema import read_result
from kits.row_of_bins import HALF, RowOfBins

from stack_counter.bag.replay import count_bag, measure_bag
from stack_counter.bag.writer import write_bag
from stack_counter.config import load_config
from stack_counter.errors import ConfigError


@pytest.fixture(scope="module")
def row():
    return RowOfBins()


@pytest.fixture(scope="module")
def recording(row, tmp_path_factory):
    path = tmp_path_factory.mktemp("row") / "bag"
    write_bag(path, row.views(camera=HALF))
    return path


def settings(tmp_path, regions):
    path = tmp_path / "settings.yaml"
    path.write_text(yaml.safe_dump({"/stack_counter/reconstructor": {
        "ros__parameters": {"regions": regions}}}))
    return path


def test_each_bin_of_the_row_has_a_count_of_its_own(row, recording, tmp_path, capsys):
    out, report = tmp_path / "r.json", tmp_path / "report"
    code, text, _ = run(capsys, "replay", recording, "--unit-volume-cm3", row.unit_volume * 1e6,
                        "--config", settings(tmp_path, row.regions()), "--direct",
                        "--json", out, "--report", report)
    assert code == 0
    results = read_result(out.read_text(), "regions")["regions"]
    table = [line.split()[:2] for line in text.splitlines() if line.startswith(("region", "bin_"))]
    assert table == [["region", "count"], *([r["name"], str(r["count"])] for r in results)]
    assert [r["name"] for r in results] == ["bin_0", "bin_1", "bin_2", "bin_3"]
    for result, true in zip(results, row.counts, strict=True):
        low, high = result["count_interval"]
        assert low <= true <= high and (true or result["count"] == 0), result["name"]
        assert result["container"]["kind"] == "box" and (result["status"] == "ok" or not true)
        assert result["views"] == {"received": 6, "used": 6, "skipped": {}}
        assert json.loads((report / result["name"] / "result.json").read_text())[
            "count"] == result["count"]
    assert json.loads((report / "result.json").read_text())["regions"] == results


def test_a_region_without_a_count_is_a_line_and_none_with_one_an_exit_code(
        row, recording, tmp_path, capsys):
    regions = row.regions()
    nowhere = {"center_m": [5.0, 0.0, 0.1], "size_m": [0.2, 0.2, 0.2]}
    count = ["replay", recording, "--unit-volume-cm3", row.unit_volume * 1e6, "--direct",
             "--config"]
    out = tmp_path / "r.json"
    code, text, error = run(capsys, *count, settings(
        tmp_path, {"away": nowhere, "bin_0": regions["bin_0"]}), "--json", out, "--live")
    assert code == 0
    assert error.startswith("stack-counter: region away: ") and "6 images in the bag" in error
    assert "\naway        -  no count: " in text
    away, full = read_result(out.read_text(), "regions")["regions"]
    assert away["count"] is None and away["status"] == "error" and away["error"] in error
    low, high = full["count_interval"]
    assert low <= row.counts[0] <= high
    assert [c["stamp_ns"] for c in full["counts"]] == [
        i * 10**9 for i in range(1, 7)]  # live: one for each view
    code, text, error = run(capsys, *count, settings(
        tmp_path, {"away": nowhere, "far": nowhere}))
    assert code == 3 and text == "" and "region away: " in error and "; region far: " in error


def test_what_gives_one_result_refuses_regions(row, recording, tmp_path):
    config = load_config(settings(tmp_path, row.regions()))
    with pytest.raises(ConfigError, match="expected none for one count"):
        count_bag(recording, unit_volume=row.unit_volume, config=config)
    with pytest.raises(ConfigError, match="expected none to measure one stack"):
        measure_bag(recording, config)
