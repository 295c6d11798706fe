# SPDX-License-Identifier: Apache-2.0
"""The parameters of `stack-counter run`; what they start is tested with the supervisor."""

import pytest
import yaml
from kits.command import run

from stack_counter.cli.main import main
from stack_counter.cli.run import parse_parameters, write_parameters
from stack_counter.config import load_config
from stack_counter.files import config_path


def test_what_is_given_stands_on_top_of_the_file_for_each_node_that_has_it(tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text("/stack_counter/counter:\n  ros__parameters:\n"
                    "    confidence: 0.8\n    use_sim_time: true\n")
    given = parse_parameters(["part:=007", "unit_volume_m3:=2e-6", "expected_count:=180",
                              "live:=true", "autostart:=false", "reliable:=false"])
    out = write_parameters(file, given, tmp_path / "out.yaml")
    config = load_config(out)
    assert (config.counter.part, config.collector.part) == ("007", "007")
    assert (config.counter.unit_volume_m3, config.counter.confidence) == (2e-6, 0.8)
    assert config.counter.expected_count == 180 and config.reconstructor.live
    assert not config.collector.reliable
    read = yaml.safe_load(out.read_text())
    assert read["/stack_counter/counter"]["ros__parameters"]["use_sim_time"] is True
    assert all(body["ros__parameters"]["autostart"] is False for body in read.values())


@pytest.mark.parametrize("line, text", [
    ("mode", "expected NAME:=VALUE"), ("nosuch:=1", "unknown parameter 'nosuch'"),
    ("mode:=often", "mode is 'often'"), ("confidence:=high", "confidence is 'high'"),
    ("confidence:=2", "confidence is 2.0"), ("live:=x", "live is 'x'")])
def test_what_no_node_takes_is_refused_before_anything_starts(capsys, line, text):
    code, _, err = run(capsys, "run", line)
    assert code == 2 and text in err


def test_the_shipped_file_takes_a_part(tmp_path):
    out = write_parameters(config_path("stack_counter.yaml"), {"part": "nut"}, tmp_path / "o.yaml")
    assert load_config(out).counter.part == "nut"


def test_a_file_may_name_nodes_as_it_likes_and_arguments_of_ros_go_to_all_nodes(
        tmp_path, monkeypatch):
    file = tmp_path / "p.yaml"
    file.write_text("collector:\n  ros__parameters: {mode: cycle, use_sim_time: true}\n")
    started = []

    def supervise(path, ros_arguments):
        started.append((yaml.safe_load(path.read_text()), ros_arguments))
        return 0

    monkeypatch.setattr("stack_counter.ros.supervisor.supervise", supervise)
    assert main(["run", "--config", str(file), "part:=nut", "--ros-args", "-r", "/a:=/b"]) == 0
    assert main(["run", "--config", str(file), "--ros-args", "-r", "__ns:=/cell1"]) == 0
    (read, remaps), (elsewhere, _) = started
    assert remaps == ["-r", "/a:=/b"]
    assert read["/stack_counter/collector"]["ros__parameters"] == {
        "mode": "cycle", "use_sim_time": True, "part": "nut"}
    assert "/**/collector" in elsewhere, "the parameters go along into another namespace"
