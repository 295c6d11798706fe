# SPDX-License-Identifier: Apache-2.0
"""The demo recording through the three real nodes: the same count as without ROS, live or not."""

import json
from pathlib import Path

import pytest
import yaml
from kits.bags import bag
from kits.painted import marks, painted, unlabelled
from kits.result_schema import read_result
from kits.row_of_bins import HALF, RowOfBins
from kits.station import station
from kits.textures import closed_container_views

from stack_counter.cli import main
from stack_counter.ros.player import Player

DEMO = Path(__file__).parents[2] / "bags" / "demo"


def replay(tmp_path, capsys, *options):
    out = tmp_path / f"result{len(list(tmp_path.iterdir()))}.json"
    assert main(["replay", str(DEMO), "--part", "demo_nut", "--json", str(out), *options]) == 0
    assert "said by network" in capsys.readouterr().out
    return read_result(out.read_text())


def test_nodes_and_direct_agree_to_the_part(tmp_path, capsys):
    nodes = replay(tmp_path, capsys, "--nodes", "--report", str(tmp_path / "report"))
    direct = replay(tmp_path, capsys, "--direct")
    for key in ("count", "count_interval", "views", "estimator", "reasons", "status", "counts"):
        assert nodes[key] == direct[key], key
    assert nodes["volume_m3"] == pytest.approx(direct["volume_m3"], rel=1e-9)
    assert nodes["views"] == {"received": 12, "used": 12, "skipped": {}}
    assert all(nodes["seconds"][s] > 0 for s in ("load", "read", "integrate", "finish", "total"))
    pictures = {p.name for p in (tmp_path / "report").iterdir()}
    assert {"top_surface.png", "key_view.png", "result.json"} <= pictures


def test_live_gives_a_count_for_each_view_both_ways(tmp_path, capsys):
    nodes = replay(tmp_path, capsys, "--nodes", "--live", "--end", "6")
    direct = replay(tmp_path, capsys, "--direct", "--live", "--end", "6")
    assert nodes["counts"] == direct["counts"]
    stamps = [entry["stamp_ns"] for entry in direct["counts"]]
    assert stamps == [(i + 1) * 10**9 for i in range(6)]
    assert direct["counts"][-1]["count"] == direct["count"]


def test_a_start_whose_answer_is_lost_is_made_again(tmp_path, monkeypatch):
    """A server drops its answer where it has not yet discovered the client."""
    answers, answer = [], Player._answer

    def lose_the_first(player, client, request, seconds):
        answers.append((client.srv_name, answer(player, client, request, seconds)))
        return answers[-1][1] if len(answers) > 1 else None
    monkeypatch.setattr(Player, "_answer", lose_the_first)
    out = tmp_path / "result.json"
    assert main(["replay", str(bag(tmp_path)), "--unit-volume-cm3", "30", "--estimator", "prior",
                 "--nodes", "--json", str(out)]) == 0
    assert read_result(out.read_text())["views"]["used"] == 6
    assert [name.split("/")[-1] for name, _ in answers[:3]] == [
        "start_scan", "reset", "start_scan"]
    assert all(each.accepted for name, each in answers if name.endswith("start_scan"))


def test_a_node_that_cannot_start_says_why(tmp_path, capsys):
    config = tmp_path / "config.yaml"
    config.write_text("/stack_counter/counter:\n  ros__parameters:\n"
                      f"    weights: {tmp_path / 'none.safetensors'}\n")
    assert main(["replay", str(DEMO), "--part", "demo_nut", "--config", str(config)]) == 2
    assert "none.safetensors" in capsys.readouterr().err


def test_prompts_give_the_same_through_the_nodes(tmp_path, capsys):
    views = painted(count=6, depth=False)
    recording, prompts = bag(tmp_path, unlabelled(views)), tmp_path / "prompts.yaml"
    prompts.write_text(json.dumps(marks(views[0].labels)))
    results = []
    for how in ("--nodes", "--direct"):
        out = tmp_path / f"{how}.json"
        assert main(["replay", str(recording), "--unit-volume-cm3", "30", "--prompts",
                     str(prompts), "--json", str(out), how]) == 0, capsys.readouterr().err
        results.append(json.loads(out.read_text()))
    assert results[0]["views"]["used"] == 6
    for key in ("count", "count_interval", "views", "reasons"):
        assert results[0][key] == results[1][key], key
    assert results[0]["volume_m3"] == pytest.approx(results[1]["volume_m3"], rel=1e-9)


def test_pictures_alone_give_the_same_through_the_nodes(tmp_path, capsys):
    """Stereo amplifies rounding: the poses must come through the messages bit by bit."""
    recording = bag(tmp_path, closed_container_views())
    results = []
    for how in ("--nodes", "--direct"):
        out = tmp_path / f"{how}.json"
        assert main(["replay", str(recording), "--unit-volume-cm3", "2", "--json", str(out), how]
                    ) == 0, capsys.readouterr().err
        results.append(json.loads(out.read_text()))
    assert "depth_from_pictures" in results[0]["reasons"]
    for key in ("count", "count_interval", "volume_m3", "volume_std_m3", "gamma", "gamma_std",
                "container", "views", "reasons"):
        assert results[0][key] == results[1][key], key


def test_each_region_gives_the_same_through_the_nodes(tmp_path, capsys):
    row, nowhere = RowOfBins((True, False), gap=0.12), {"center_m": [5.0, 0.0, 0.1],
                                                        "size_m": [0.2, 0.2, 0.2]}
    recording = bag(tmp_path, row.views(count=4, camera=HALF))
    settings = tmp_path / "settings.yaml"
    settings.write_text(yaml.safe_dump({"/stack_counter/reconstructor": {
        "ros__parameters": {"regions": {"away": nowhere, **row.regions(0.05)}}}}))
    results = {}
    for how in ("--nodes", "--direct"):
        out = tmp_path / f"{how}.json"
        assert main(["replay", str(recording), "--unit-volume-cm3", str(row.unit_volume * 1e6),
                     "--config", str(settings), "--live", "--json", str(out), how]) == 0
        error, = capsys.readouterr().err.splitlines()[-1:]
        assert error.startswith("stack-counter: region away: ")
        results[how] = read_result(out.read_text(), "regions")["regions"]
    assert [r["name"] for r in results["--nodes"]] == ["away", "bin_0", "bin_1"]
    for ours, same in zip(results["--nodes"], results["--direct"], strict=True):
        for key in ours.keys() - {"seconds", "container"}:
            assert ours[key] == same[key], (ours["name"], key)
    assert [r["count"] is None for r in results["--nodes"]] == [True, False, False]
    assert [len(r["counts"]) for r in results["--nodes"][1:]] == [4, 4]


def test_a_station_counts_every_cycle_and_names_the_dead_camera(tmp_path, capsys, monkeypatch):
    """Four cameras, five fills; in the third cycle one camera gives nothing."""
    root = DEMO.parents[1]
    monkeypatch.chdir(root)  # the settings name the rig file from there
    truth = json.loads((root / "bags" / "station" / "truth.json").read_text())
    counts = {}
    for how in ("--nodes", "--direct"):
        out = tmp_path / f"{how}.json"
        assert main(["replay", "bags/station", "--config", "config/station.yaml",
                     "--unit-volume-cm3", str(truth["unit_volume_cm3"]), how,
                     "--json", str(out)]) == 0
        assert "without back" in capsys.readouterr().out
        counts[how] = read_result(out.read_text())["counts"]
    assert counts["--nodes"] == counts["--direct"]
    assert [c.get("missing_cameras") for c in counts["--direct"]] == [
        None, None, ["back"], None, None]
    for entry, true in zip(counts["--direct"], truth["counts"], strict=True):
        low, high = entry["count_interval"]
        assert low <= true["count"] <= high


def test_a_failed_cycle_is_a_row_and_takes_nothing_from_the_others(tmp_path, capsys):
    """One in the middle and the last; and one without any view, which is no cycle."""
    recording, settings = station(tmp_path, cycles=5, failed=(1, 4), blurred=(2,))
    results, rows = [], []
    for how in ("--nodes", "--direct"):
        out = tmp_path / f"{how}.json"
        assert main(["replay", str(recording), "--config", str(settings), "--unit-volume-cm3",
                     "1.5", "--estimator", "prior", how, "--json", str(out)]) == 0
        printed = capsys.readouterr()
        rows.append([line for line in printed.out.splitlines() if line.startswith("cycle at ")])
        assert printed.err.count("stack-counter: cycle at ") == 2
        results.append(json.loads(out.read_text()))
    assert rows[0] == rows[1] and results[0]["counts"] == results[1]["counts"]
    assert results[0]["count"] == results[1]["count"] == results[0]["counts"][2]["count"] > 0
    assert [entry["count"] is None for entry in results[0]["counts"]] == [
        False, True, False, True]
    failed = results[0]["counts"][3]
    assert failed["stamp_ns"] == 5 * 10**9 and failed["error"].startswith("1 views used of 1")
    assert failed["missing_cameras"] == ["camera1", "camera2", "camera3"]
    assert rows[0][3] == ("cycle at 5.000 s: no count, without camera1, camera2, camera3: "
                          + failed["error"])
