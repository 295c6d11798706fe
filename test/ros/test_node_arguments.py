# SPDX-License-Identifier: Apache-2.0
"""Nodes take parameter files that call them by their bare names."""

import rclpy
from rclpy.node import Node

from stack_counter.parameter_files import NAMESPACE
from stack_counter.ros.diagnostics import data_age_s
from stack_counter.ros.node_arguments import fully_named


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
