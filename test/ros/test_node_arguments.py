# SPDX-License-Identifier: Apache-2.0
"""Nodes take parameter files that call them by their bare names, and remappings."""

import os
import runpy
import subprocess
import sys

import pytest
import rclpy
from rclpy.node import Node

from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.ros.diagnostics import data_age_s
from stack_counter.ros.node_arguments import fully_named
from stack_counter.ros.private_domain import PrivateDomain


def parameters_of_a_node(arguments):
    """Values that rclpy gives a collector which is started with these arguments."""
    context = rclpy.Context()
    rclpy.init(args=["collector", "--ros-args", *arguments], context=context)
    node = Node("collector", namespace=NAMESPACE, context=context,
                automatically_declare_parameters_from_overrides=True)
    try:
        return {name: p.value for name, p in node.get_parameters_by_prefix("").items()}
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_bare_names_are_those_of_nodes_in_any_namespace(tmp_path):
    bare, full = tmp_path / "bare.yaml", tmp_path / "full.yaml"
    bare.write_text("collector:\n  ros__parameters:\n    a: 1e-3\n    collector: x\n"
                    "'counter':\n  ros__parameters: {a: 2}\n")
    full.write_text("/stack_counter/collector:\n  ros__parameters: {b: 3}\n")
    given = ["--params-file", str(bare), "--params-file", str(full), "-p", "c:=4"]
    with fully_named(given) as arguments:
        assert arguments[2:] == given[2:], "only what needs it is rewritten"
        read = parameters_of_a_node(arguments)
        elsewhere = parameters_of_a_node([*arguments, "-r", "__ns:=/cell1"])
    expected = {"a": 0.001, "collector": "x", "b": 3, "c": 4}
    assert {name: read.get(name) for name in expected} == expected
    assert elsewhere["a"] == 0.001 and "b" not in elsewhere


def test_data_has_no_age_before_the_clock_of_a_bag_has_come():
    assert data_age_s(3 * 10**9, 10**9) == 2.0
    assert str(data_age_s(0, 10**9)) == "nan"


REMAPPED = """
import pytest
import rclpy
from stack_counter.nodes.collector import Collector

rclpy.init()
node = Collector()
node.trigger_configure()
print(sorted(s.topic_name for s in node.subscriptions))
print(sorted(p.topic_name for p in node.publishers))
print(sorted(s.service_name for s in node.services))
print(node.get_clock().now().nanoseconds)
"""


def test_all_topics_of_a_collector_can_be_remapped_and_its_clock_be_that_of_a_bag():
    remaps = {"/camera/color/image_raw": "/cell/rgb", "/camera/color/camera_info": "/cell/info",
              "/camera/aligned_depth_to_color/image_raw": "/cell/depth",
              "/camera/aligned_depth_to_color/camera_info": "/cell/depth_info", "/tf": "/cell/tf",
              "posed_images": "views", "start_scan": "begin_scan"}
    rules = [word for name, other in remaps.items() for word in ("-r", f"{name}:={other}")]
    with PrivateDomain() as domain:
        done = subprocess.run(
            [sys.executable, "-c", REMAPPED, "--ros-args", *rules, "-p", "use_sim_time:=true",
             "-p", "color_transport:=raw"],
            capture_output=True, text=True, timeout=120, env={**os.environ, **domain.environment})
    subscribed, published, services, now = done.stdout.splitlines()
    for topic in ("/cell/rgb", "/cell/info", "/cell/depth", "/cell/tf", "/clock"):
        assert f"'{topic}'" in subscribed, done.stderr
    assert "/camera" not in subscribed and "'/tf'" not in subscribed
    assert "'/stack_counter/views'" in published and "posed_images" not in published
    assert "begin_scan" in services and "start_scan" not in services, services
    assert now == "0", "nobody publishes /clock, and nothing waits for it"


@pytest.mark.parametrize("words", [[], ["robot"], ["collectr"]])
def test_a_node_that_is_none_is_refused_in_one_line(words, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["nodes", *words])
    with pytest.raises(SystemExit) as caught:
        runpy.run_module("stack_counter.nodes", run_name="__main__")
    said = capsys.readouterr().err
    assert caught.value.code == 2 and said.count("\n") == 1
    assert f"no node '{''.join(words)}'; expected one of collector, reconstructor, counter" in said
