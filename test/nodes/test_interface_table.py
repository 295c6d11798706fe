# SPDX-License-Identifier: Apache-2.0
"""docs/interface.md against the running nodes, and that they all have the lifecycle."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from kits.interface_table import SPACE, full, table
from kits.part_weights import write_part_weights
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.action.graph import get_action_server_names_and_types_by_node
from sensor_msgs.msg import CompressedImage, Image

# Every ROS 2 node has these.
OWN = ("rosout", "parameter_events", "transition_event", "parameters", "parameter", "state",
       "transitions", "transition_graph", "type_description", "_action")
SETTINGS = {"collector": ("min_change", 9.0, "part", "x"),
            "reconstructor": ("prompts", "", "min_views", 4),
            "counter": ("confidence", 0.8, "estimator", "depth_corrected")}


def is_own(name):
    return any(word in name for word in OWN)


def running(node, name):
    """The same of a running node."""
    graph = {"subscribes": node.get_subscriber_names_and_types_by_node,
             "publishes": node.get_publisher_names_and_types_by_node,
             "serves": node.get_service_names_and_types_by_node,
             "calls": node.get_client_names_and_types_by_node,
             "offers": lambda n, s: get_action_server_names_and_types_by_node(node, n, s)}
    return {(name, how, topic, kind) for how, ask in graph.items()
            for topic, kinds in ask(name, SPACE) for kind in kinds if not is_own(topic)}


def value(x):
    kinds = {float: ("DOUBLE", "double_value"), str: ("STRING", "string_value"),
             int: ("INTEGER", "integer_value")}
    kind, field = kinds[type(x)]
    return ParameterValue(type=getattr(ParameterType, f"PARAMETER_{kind}"), **{field: x})


@pytest.fixture(scope="module")
def ros(ros_of_module, tmp_path_factory):
    """Three nodes and who looks at them."""
    counter = {"estimator": "prior", "result_json": "true", "visible_parts_weights": str(
        write_part_weights(tmp_path_factory.mktemp("weights") / "visible.safetensors"))}
    for name in SETTINGS:
        ros_of_module.start(name, **(counter if name == "counter" else {}))
    return ros_of_module


def test_the_table_is_what_the_nodes_have(ros):
    expected = {(node, how, full(name), kind) for node, how, name, kind in table()}
    raw, compressed = (("collector", "subscribes", "/camera/color/image_raw" + suffix, kind)
                       for suffix, kind in (("", "sensor_msgs/msg/Image"),
                                            ("/compressed", "sensor_msgs/msg/CompressedImage")))
    assert {raw, compressed} <= expected
    # Images whose raw topic is there are not asked for by another transport.
    beside = {row for row in expected if row[3] == compressed[3]}
    assert len(beside) == 3

    ros.wait(lambda: set(SETTINGS) <= set(ros.node.get_node_names()), "three nodes")

    def found():
        return set().union(*(running(ros.node, name) for name in SETTINGS))
    ros.wait(lambda: len(found()) >= len(expected - beside), "the whole graph")
    assert found() == expected - beside
    # Colour images come by the transport that is published, and raw ones are preferred.
    camera = ros.node.create_publisher(CompressedImage, compressed[2], 10)
    ros.wait(lambda: found() == expected - beside - {raw} | {compressed},
             "compressed images are asked for")
    other = ros.node.create_publisher(Image, raw[2], 10)
    ros.wait(lambda: found() == expected - beside, "raw images are asked for")
    ros.node.destroy_publisher(other)
    ros.node.destroy_publisher(camera)


@pytest.mark.parametrize("name", SETTINGS)
def test_states_and_parameters(ros, name):
    diagnostics = ros.collect_messages(DiagnosticArray, "/diagnostics")

    def state():
        return ros.call(GetState, f"{SPACE}/{name}/get_state", GetState.Request()).current_state.id

    def change(transition):
        return ros.call(ChangeState, f"{SPACE}/{name}/change_state", ChangeState.Request(
            transition=Transition(id=transition))).success

    def put(key, x):
        return ros.call(SetParameters, f"{SPACE}/{name}/set_parameters", SetParameters.Request(
            parameters=[Parameter(name=key, value=value(x))])).results[0]

    def values():
        status = [s for m in diagnostics for s in m.status if s.name == f"stack_counter: {name}"]
        return {v.key: v.value for v in status[-1].values} if status else {}

    ros.wait(lambda: state() == State.PRIMARY_STATE_ACTIVE, "an active node")
    free, new, fixed, other = SETTINGS[name]
    assert put(free, new).successful
    refused = put(fixed, other)
    assert not refused.successful and "unconfigured" in refused.reason
    described = ros.call(DescribeParameters, f"{SPACE}/{name}/describe_parameters",
                         DescribeParameters.Request(names=[free, fixed])).descriptors
    runtime, on_configure = (d.additional_constraints for d in described)
    assert runtime.endswith("may change at run time")
    assert on_configure == "read on configure; set it while the node is unconfigured"
    assert change(Transition.TRANSITION_DEACTIVATE) and state() == State.PRIMARY_STATE_INACTIVE
    ros.wait(lambda: values().get("state") == "inactive", "diagnostics that say so")
    assert change(Transition.TRANSITION_ACTIVATE) and change(Transition.TRANSITION_DEACTIVATE)
    assert change(Transition.TRANSITION_CLEANUP)
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert put(fixed, other).successful
    path = put("result_log" if name == "counter" else "report_folder"
               if name == "reconstructor" else "record_folder", "/x")
    assert not path.successful and "which no request may name" in path.reason
    if name == "collector":  # there is no such part: said, and the node stays up
        assert not change(Transition.TRANSITION_CONFIGURE)
        assert put(fixed, "").successful
    assert change(Transition.TRANSITION_CONFIGURE) and change(Transition.TRANSITION_ACTIVATE)
    ros.wait(lambda: values().get("state") == "active" and float(values()["memory MB"]) > 50,
             "diagnostics of an active node")
