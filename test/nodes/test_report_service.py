# SPDX-License-Identifier: Apache-2.0
"""The service `write_report`: which count it writes, and where."""

import json
from pathlib import Path

import numpy as np
import pytest
from stack_counter_msgs.msg import StackCount
from std_srvs.srv import Trigger

from stack_counter.config import ReconstructorConfig
from stack_counter.config.named_region import NamedRegion
from stack_counter.nodes.report_service import ReportService, new_folder
from stack_counter.ros.standard_messages import to_header
from stack_counter.types import Container, Mesh, StackVolume, ViewTally

STAMP = 1_700_000_000_123_456_789  # 2023-11-14, 22:13:20
MESH = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32))


class Node:
    """Has what the service needs of its node."""

    def subscribe(self, kind, topic, callback, qos):
        assert topic in ("result", "running_count")
        self.count = callback

    def add_service(self, kind, name, callback):
        assert name == "write_report"
        self.write = lambda: callback(Trigger.Request(), Trigger.Response())


def start(folder, regions=0):
    made = Node()
    named = tuple(NamedRegion(str(i), (i, 0, 0), (1, 1, 1)) for i in range(regions))
    made.reports = ReportService(made, ReconstructorConfig(report_folder=str(folder),
                                                           regions=named))
    return made


@pytest.fixture
def node(tmp_path):
    return start(tmp_path / "reports")


def volume(stamp_ns=STAMP, litres=1.0, region=""):
    return StackVolume(stamp_ns, litres * 1e-3, 1e-5, Container("none", np.eye(4)), (0, 0, 0), 1.0,
                       None, None, None, ViewTally(12, 12), mesh=MESH, region=region)


def count(scan_id, stamp_ns=STAMP, number=412, final=True, error="", region=""):
    return StackCount(header=to_header(stamp_ns, "base_link"), scan_id=scan_id, count=number,
                      count_low=number - 9, count_high=number + 9, confidence=0.9, gamma=0.4,
                      unit_volume=1e-6, estimator="e", final=final, error=error,
                      region=region)


def written(answer):
    """Returns result.json of the folder that the service names."""
    assert answer.success, answer.message
    return json.loads((Path(answer.message) / "result.json").read_text())


def test_a_count_is_written_once_with_the_mesh_of_its_volume(node, tmp_path):
    node.reports.keep_volume("bin 7", True, volume())
    node.count(count("bin 7"))
    answer = node.write()
    assert answer.message == str(tmp_path / "reports" / "report_20231114-221320-123_bin-7")
    result = written(answer)
    assert (result["count"], result["count_interval"], result["gamma"]) == (412, [403, 421], 0.4)
    assert result["volume_m3"] == 1e-3 and result["views"]["used"] == 12
    assert {p.name for p in Path(answer.message).iterdir()} == {
        "report.html", "result.json", "surface.glb", "surface.ply", "surface.png"}
    page = (Path(answer.message) / "report.html").read_text()
    assert "bin 7" in page and ">412<" in page
    assert node.write().message == answer.message
    node.reports.keep_volume("bin 7", True, volume())  # another one of that name and time
    node.count(count("bin 7", number=300))
    again = node.write()
    assert again.message == answer.message + "-2" and written(again)["count"] == 300
    assert written(answer) == result


def test_without_a_folder_or_a_count_it_says_what_is_missing(node):
    assert "nothing was counted yet" in node.write().message
    node.reports.keep_volume("a", True, volume())
    waiting = node.write()
    assert not waiting.success and "scan 'a' is not counted yet" in waiting.message
    node.count(count("a", error="unknown part 'x'"))
    failed = node.write()
    assert not failed.success and failed.message == "no report: scan 'a': unknown part 'x'"
    unset = start("").write()
    assert not unset.success and "report_folder is ''; expected a folder" in unset.message
    assert "\n" not in unset.message


def test_a_folder_that_cannot_be_made_is_an_answer(tmp_path):
    (tmp_path / "file").write_text("")
    node = start(tmp_path / "file")
    node.reports.keep_volume("a", True, volume())
    node.count(count("a"))
    answer = node.write()
    assert not answer.success and str(tmp_path / "file") in answer.message


def test_each_count_finds_its_own_volume(node):
    node.reports.keep_volume("a", False, volume(STAMP, 1.0))
    node.reports.keep_volume("a", False, volume(STAMP + 1, 2.0))
    node.reports.keep_volume("a", True, volume(STAMP + 1, 3.0))
    node.count(count("a", STAMP - 1, 99))  # of the time before this node
    node.count(count("b", STAMP, 98))
    assert "not counted yet" in node.write().message
    node.count(count("a", STAMP + 1, 20, final=False))  # the first was not counted
    node.count(count("a", STAMP + 1, 30))
    result = written(node.write())
    assert (result["count"], result["volume_m3"]) == (30, 3e-3)


def test_in_continuous_mode_the_last_one_counted_is_written(node):
    for i in range(7):  # more than are kept
        node.reports.keep_volume("a", False, volume(STAMP + i, i))
    node.count(count("a", STAMP + 4, 40, final=False))
    result = written(node.write())
    assert (result["count"], result["volume_m3"]) == (40, 4e-3)


def test_every_region_of_the_last_scan_has_a_folder_of_its_own(tmp_path):
    node = start(tmp_path, regions=3)
    for name in ("left", "middle", "right"):  # one after the other, before any count comes
        node.reports.keep_volume("a", True, volume(region=name))
    node.count(count("a", number=4, region="left"))
    node.count(count("a", error="nothing left", region="middle"))
    assert "not counted yet" in node.write().message
    node.count(count("a", number=5, region="right"))
    folder = Path(node.write().message)
    assert {path.name: json.loads((path / "result.json").read_text())["count"]
            for path in folder.iterdir()} == {"left": 4, "right": 5}
    node.reports.keep_volume("b", True, volume(region="left"))
    node.count(count("b", number=6, region="left"))
    assert [path.name for path in Path(node.write().message).iterdir()] == ["left"]
    node.count(count("b", error="a node died"))  # the scan is lost
    assert "scan 'b': a node died" in node.write().message


@pytest.mark.parametrize("scan_id, name", [
    ("../../x", "-x"), ("..", "-"), ("", "scan"), ("/etc/passwd", "-etc-passwd"),
    ("a\0b\nc", "a-b-c"), ("Bin-7_b", "Bin-7_b"), ("ä€", "-"), ("n" * 500, "n" * 40)])
def test_a_scan_id_cannot_leave_the_folder(tmp_path, scan_id, name):
    folder = new_folder(tmp_path / "reports", scan_id, STAMP)
    assert folder == tmp_path / "reports" / f"report_20231114-221320-123_{name}"
    assert folder.is_dir() and folder.resolve().parent == (tmp_path / "reports").resolve()
    assert [p.name for p in tmp_path.iterdir()] == ["reports"]
