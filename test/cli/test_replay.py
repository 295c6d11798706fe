# SPDX-License-Identifier: Apache-2.0
"""The command `replay`: exit codes, one line on stderr, and the JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest
from kits.bags import FRAME, bag, bin_views
from kits.command import run
from kits.painted import marks, painted, unlabelled
from kits.result_schema import read_result
from kits.station import station
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from stack_counter.cli.replay import _true_count
from stack_counter.errors import BagError

UNIT = ["--unit-volume-cm3", "1.5"]


def without(path, out, topics):
    """A copy of a bag without some topics; written uncompressed."""
    with Reader(path) as source, Writer(out, version=9,
                                        storage_plugin=StoragePlugin.MCAP) as target:
        kept = {c.id: target.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data,
                                            rihs01=c.digest)
                for c in source.connections if c.topic not in topics}
        for connection, stamp, data in source.messages():
            if connection.id in kept:
                target.write(kept[connection.id], stamp, data)
    return out


def test_count_and_every_key_of_the_json(tmp_path, capsys):
    path, out = bag(tmp_path), tmp_path / "r.json"
    code, text, _ = run(capsys, "replay", path, *UNIT, "--direct", "--json", out, "--report",
                        tmp_path / "report", "--confidence", "0.8")
    assert code == 0 and "said by network" in text and "80% sure" in text
    result = read_result(out.read_text())
    assert result.keys() >= {
        "count", "count_interval", "confidence", "gamma", "gamma_std", "volume_m3",
        "volume_std_m3", "unit_volume_m3", "container", "views", "estimator", "seconds", "status",
        "reasons", "counts"}
    low, high = result["count_interval"]
    assert all(isinstance(n, int) for n in (low, high, result["count"]))
    assert low <= result["count"] <= high
    assert result["container"].keys() >= {"kind", "inner_size_m", "wall_thickness_m", "pose"}
    assert result["container"]["kind"] == "box"
    assert result["views"] == {"received": 6, "used": 6, "skipped": {}}
    assert set(result["seconds"]) == {"load", "read", "segment", "integrate", "finish", "gamma",
                                      "total"}
    assert result["volume_m3"] == pytest.approx(0.2 * 0.15 * 0.05, rel=0.1)
    assert result["count"] == round(result["gamma"] * result["volume_m3"] / 1.5e-6)
    assert {p.name for p in (tmp_path / "report").iterdir()} == {
        "report.html", "result.json", "top_surface.png", "key_view.png", "container.png",
        "surface.png", "surface.glb", "surface.ply"}


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"count": Infinity}', "[" * 100_000])
def test_a_stated_count_that_is_none_is_refused(tmp_path, text):
    (tmp_path / "truth.json").write_text(text)
    with pytest.raises(BagError, match="truth.json is malformed at .*mend it or remove it"):
        _true_count(tmp_path)


def test_live_has_an_entry_for_each_view_used(tmp_path, capsys):
    out = tmp_path / "r.json"
    assert run(capsys, "replay", bag(tmp_path), *UNIT, "--direct", "--live", "--json", out)[0] == 0
    counts = read_result(out.read_text())["counts"]
    assert [c["stamp_ns"] for c in counts] == [i * 10**9 for i in range(1, 7)]


def test_empty_bin_counts_zero(tmp_path, capsys):
    code, out, _ = run(capsys, "replay", bag(tmp_path, bin_views(fill=0.0)), *UNIT, "--direct")
    assert code == 0 and out.startswith("count      0 parts, 90% sure between 0 and 0")


@pytest.mark.parametrize("options, said", [
    ([], "no part named and no unit volume given"),
    (["--unit-volume-cm3", "0"], "unit volume is 0.0"),
    (["--unit-volume-cm3", "-3"], "expected a finite number above 0"),
    (["--unit-volume-cm3", "nan"], "unit volume is nan"),
    (["--part", "no_such"], "unknown part 'no_such'; expected one of ['demo_nut'"),
    ([*UNIT, "--confidence", "1.5"], "confidence is 1.5"),
    ([*UNIT, "--estimator", "guess"], "estimator is 'guess'; expected one of"),
    ([*UNIT, "--weights", "none.safetensors"], "no weights file none.safetensors"),
    ([*UNIT, "--config", "none.yaml"], "none.yaml"),
    ([*UNIT, "--rate", "-1"], "--rate is -1.0"),
    ([*UNIT, "--arrangement"], "--arrangement without --report; expected --report DIR"),
    ([*UNIT, "--arrangement", "--report", "out"], "which has no mesh; expected one"),
])
def test_bad_options_exit_2_with_one_line(tmp_path, capsys, options, said):
    path = bag(tmp_path)
    code, _, err = run(capsys, "replay", path, "--direct", *options)
    assert code == 2 and said in err


@pytest.mark.parametrize("text, said", [
    ("/stack_counter/reconstructor: {ros__parameters: {voxel: 1}}", "unknown setting 'voxel'"),
    ("/stack_counter/reconstructor: {ros__parameters: {voxel_size: 9.0}}", "voxel_size is 9.0"),
    ("/stack_counter/reconstructor: {ros__parameters: {voxel_size: big}}", "expected float"),
    ("/somebody_else: {ros__parameters: {}}", "names node '/somebody_else'"),
    ("a: [", "is not YAML"), ("- 1", "holds list")])
def test_bad_configuration_exits_2(tmp_path, capsys, text, said):
    config = tmp_path / "c.yaml"
    config.write_text(text)
    code, _, err = run(capsys, "replay", bag(tmp_path), *UNIT, "--direct", "--config", config)
    assert code == 2 and said in err


def test_paths_that_are_not_there_or_no_bags(tmp_path, capsys):
    assert run(capsys, "replay", tmp_path / "none", *UNIT)[0] == 2
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"not a bag at all")
    code, _, err = run(capsys, "replay", junk, *UNIT, "--direct")
    assert code == 3 and "is no recording: it begins with" in err
    (tmp_path / "folder").mkdir()
    code, _, err = run(capsys, "replay", tmp_path / "folder", *UNIT, "--direct")
    assert code == 3 and "no .mcap file" in err


def test_bags_that_lack_a_topic_say_which(tmp_path, capsys):
    path = bag(tmp_path)
    color = "/camera/color/image_raw/compressed"
    code, _, err = run(capsys, "replay", without(path, tmp_path / "a", {color}), *UNIT, "--direct")
    assert code == 3 and "no images on /camera/color/image_raw" in err and "/tf" in err
    code, _, err = run(capsys, "replay",
                       without(path, tmp_path / "b", {"/camera/color/camera_info"}), *UNIT,
                       "--direct")
    assert code == 3 and "6 images in the bag, skipped {'no_camera_info': 6}" in err
    assert err.rstrip().endswith("stack-counter doctor BAG says what to change")
    code, _, err = run(capsys, "replay", without(path, tmp_path / "c", {"/tf"}), *UNIT, "--direct")
    assert code == 3 and "'no_tf': 6" in err and "no transforms connect" in err


def test_a_world_frame_of_another_name_is_advised(tmp_path, capsys):
    code, _, err = run(capsys, "replay", bag(tmp_path, world_frame="world"), *UNIT, "--direct")
    assert code == 3 and "set world_frame to 'world'" in err


def test_loop_in_tf(tmp_path, capsys):
    loop = [(10**9 * i, a, b, np.eye(4)) for i in range(1, 7)
            for a, b in (("base_link", FRAME), (FRAME, "base_link"))]
    code, _, err = run(capsys, "replay", bag(tmp_path, transforms=loop), *UNIT, "--direct")
    assert code == 3 and "tf_loop" in err


def test_too_few_views_and_nothing_left(tmp_path, capsys):
    code, _, err = run(capsys, "replay", bag(tmp_path, bin_views(count=2)), *UNIT, "--direct")
    assert code == 3 and "2 views used of 2" in err and "expected at least 3" in err
    blank = [replace(v, depth=None, labels=np.zeros((120, 160), np.uint8)) for v in bin_views()]
    code, _, err = run(capsys, "replay", bag(tmp_path, blank, "blank"), *UNIT, "--direct")
    assert code == 3 and "all 6 label images are background" in err
    other = [replace(v, depth=None, labels=np.full((120, 160), 9, np.uint8)) for v in bin_views()]
    code, _, err = run(capsys, "replay", bag(tmp_path, other, "other"), *UNIT, "--direct")
    assert code == 3 and "'bad_labels': 6" in err


def test_a_bag_cut_anywhere_is_counted_or_refused_in_one_line(tmp_path, capsys):
    whole = next(without(bag(tmp_path), tmp_path / "raw", set()).glob("*.mcap")).read_bytes()
    packed = next((tmp_path / "bag").glob("*.mcap")).read_bytes()
    codes = set()
    for data in (whole, packed):
        for share in (0.001, 0.03, 0.2, 0.5, 0.7, 0.8, 0.9, 0.97, 0.999):
            cut, out = tmp_path / "cut.mcap", tmp_path / "cut.json"
            cut.write_bytes(data[:int(len(data) * share)])
            code, _, err = run(capsys, "replay", cut, *UNIT, "--direct", "--json", out)
            codes.add(code)
            if code == 0:
                result = read_result(out.read_text())
                assert "bag_truncated" in result["reasons"] and result["status"] == "degraded"
                assert result["views"]["used"] >= 3
            else:
                assert code == 3 and err
    assert codes == {0, 3}


def prompts_file(tmp_path, document=None):
    path = tmp_path / "prompts.yaml"
    path.write_text(json.dumps(document or marks(painted()[0].labels)))
    return path


def test_prompts_label_pictures_that_have_nothing_else(tmp_path, capsys):
    path = bag(tmp_path, unlabelled(painted(count=6, depth=False)))
    code, _, err = run(capsys, "replay", path, *UNIT, "--direct")
    assert code == 3 and "'no_depth': 6" in err
    out = tmp_path / "r.json"
    first = painted(count=6, depth=False)[0]
    assert run(capsys, "replay", path, *UNIT, "--direct", "--json", out, "--prompts",
               prompts_file(tmp_path, marks(first.labels)))[0] == 0
    result = read_result(out.read_text())
    assert result["seconds"]["read"] > 0 and result["seconds"]["segment"] > 0
    assert result["container"]["kind"] == "hull" and result["views"]["used"] == 6
    labelled = bag(tmp_path, painted(count=6, depth=False), "labelled")
    assert run(capsys, "replay", labelled, *UNIT, "--direct", "--json", out)[0] == 0
    true = json.loads(out.read_text())
    assert result["volume_m3"] == pytest.approx(true["volume_m3"], rel=0.08)


@pytest.mark.parametrize("mode", ["--direct", "--nodes"])
@pytest.mark.parametrize("document, said", [
    ({"parts": {"boxes": [[0, 0, 900, 80]]}}, "outside of the 160x120 image"),
    ({"part": {}}, "unknown key 'part'"),
    (None, "no prompts file")])
def test_bad_prompts_exit_2_before_anything_starts(tmp_path, capsys, mode, document, said):
    path = prompts_file(tmp_path, document) if document else tmp_path / "none.yaml"
    code, _, err = run(capsys, "replay", bag(tmp_path), *UNIT, mode, "--prompts", path)
    assert code == 2 and said in err


def test_prompts_go_to_sam2_if_the_settings_say_so(tmp_path, capsys):
    config = tmp_path / "c.yaml"
    config.write_text("/stack_counter/reconstructor: {ros__parameters: {segmenter: sam2, "
                      f"sam2_weights: {tmp_path / 'none'}}}}}")
    code, _, err = run(capsys, "replay", bag(tmp_path), *UNIT, "--direct", "--config", config,
                       "--prompts", prompts_file(tmp_path, {"parts": {"points": [[80, 60]]}}))
    assert code == 2 and "no folder" in err and "SAM 2" in err


def test_cycles_of_which_none_counts_say_why_and_how_many(tmp_path, capsys):
    recording, settings = station(tmp_path, cycles=2, failed=(0, 1))
    code, out, error = run(capsys, "replay", recording, *UNIT, "--config", settings, "--direct")
    assert (code, out) == (3, "") and "\n" not in error
    assert error.startswith("stack-counter: cycle at 1.000 s: 1 views used of 1")
    assert "none of 2 cycles gives a count; 2 images in the bag" in error
