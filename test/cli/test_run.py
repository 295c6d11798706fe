# SPDX-License-Identifier: Apache-2.0
"""The parameters of `stack-counter run`; what they start is tested with the supervisor."""

import sys
from importlib import import_module

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
    out = tmp_path / "out.yaml"
    config = write_parameters(file, given, out)
    assert load_config(out) == config
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
    ("confidence:=2", "confidence is 2.0"), ("live:=x", "live is 'x'"),
    ("part:=nosuch", "unknown part 'nosuch'"), ("container:=nosuch", "container 'nosuch'")])
def test_what_no_node_takes_is_refused_before_anything_starts(capsys, line, text):
    code, _, err = run(capsys, "run", line)
    assert code == 2 and text in err


def test_the_shipped_file_takes_a_part(tmp_path):
    shipped = config_path("stack_counter.yaml")
    assert write_parameters(shipped, {"part": "nut"}, tmp_path / "o.yaml").counter.part == "nut"


def test_a_part_that_the_file_names_is_looked_up_too(capsys, tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text("/stack_counter/counter:\n  ros__parameters: {part: nosuch}\n")
    code, _, err = run(capsys, "run", "--config", file)
    assert code == 2 and "unknown part 'nosuch'" in err


@pytest.mark.parametrize("module", ["supervisor", "viewer"])
def test_the_words_of_a_command_are_not_for_ros(monkeypatch, module):
    # As global arguments, mode:=scan would be a remap rule in old syntax, which ROS warns of.
    pytest.importorskip("rclpy")
    monkeypatch.setattr("sys.argv", ["stack-counter", "run", "mode:=scan"])
    started = import_module(f"stack_counter.ros.{module}")

    def refuse(args=None, **_):
        raise InterruptedError(*(sys.argv if args is None else args))

    monkeypatch.setattr(started.rclpy, "init", refuse)
    with pytest.raises(InterruptedError) as caught:
        if module == "supervisor":
            started.supervise(config_path("stack_counter.yaml"), [])
        else:
            started.view([], "127.0.0.1", 0, print)
    assert "mode:=scan" not in caught.value.args


def test_a_file_may_name_nodes_as_it_likes_and_arguments_of_ros_go_to_all_nodes(
        tmp_path, monkeypatch):
    file = tmp_path / "p.yaml"
    file.write_text("collector:\n  ros__parameters: {mode: cycle, use_sim_time: true}\n")
    started = []

    def supervise(path, ros_arguments):
        started.append((yaml.safe_load(path.read_text()), ros_arguments))
        return 0

    monkeypatch.setattr("stack_counter.ros.supervisor.supervise", supervise)
    assert main(["run", "--config", str(file), "part:=demo_nut", "--ros-args", "-r",
                 "/a:=/b"]) == 0
    assert main(["run", "--config", str(file), "--ros-args", "-r", "__ns:=/cell1"]) == 0
    (read, remaps), (elsewhere, _) = started
    assert remaps == ["-r", "/a:=/b"]
    assert read["/stack_counter/collector"]["ros__parameters"] == {
        "mode": "cycle", "use_sim_time": True, "part": "demo_nut"}
    assert "/**/collector" in elsewhere, "the parameters go along into another namespace"
