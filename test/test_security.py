# SPDX-License-Identifier: Apache-2.0
"""The SROS 2 policy grants what the interface table lists and nothing else; the threat model."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from kits.interface_table import NODES, SUPERVISOR, table
from rclpy.clock import ClockType
from rclpy.node import Node

from stack_counter.ros import supervisor

ROOT = Path(__file__).parents[1]
EVERY = (*NODES, SUPERVISOR)
HOW = {("topics", "subscribe"): "subscribes", ("topics", "publish"): "publishes",
       ("services", "reply"): "serves", ("services", "request"): "calls",
       ("actions", "execute"): "offers"}
# What every node of ROS 2 Jazzy has, and every lifecycle node besides.
OWN = {("subscribes", "/parameter_events"), ("subscribes", "/clock"),
       ("publishes", "/parameter_events"), ("publishes", "/rosout"),
       *(("serves", f"~/{name}") for name in (
           "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters",
           "set_parameters", "set_parameters_atomically", "get_type_description"))}
LIFECYCLE = {("publishes", "~/transition_event"),
             *(("serves", f"~/{name}") for name in (
                 "change_state", "get_state", "get_available_states", "get_available_transitions",
                 "get_transition_graph"))}


def enclaves():
    """The policy's enclaves by path."""
    policy = ElementTree.parse(ROOT / "config" / "sros2_policy.xml").getroot()
    return {enclave.get("path"): enclave for enclave in policy.iter("enclave")}


def granted(node):
    """(how, name) of all that the policy grants a node."""
    (profile,) = enclaves()[f"/stack_counter/{node}"].findall("profiles/profile")
    assert (profile.get("ns"), profile.get("node")) == ("/stack_counter", node)
    grants = []
    for group in profile:
        (attribute, value), = group.attrib.items()
        assert value == "ALLOW"
        grants += [(HOW[group.tag, attribute], item.text) for item in group]
    assert len(grants) == len(set(grants)) and not any("*" in name for _, name in grants)
    return set(grants)


def listed(node):
    """(how, name) of all that the interface table lists for a node."""
    return {(how, name) for _, how, name, _ in table([node])}


def test_the_policy_has_an_enclave_for_each_node():
    assert set(enclaves()) == {f"/stack_counter/{node}" for node in EVERY}
    assert {row[0] for row in table(EVERY)} == set(EVERY)


@pytest.mark.parametrize("node", EVERY)
def test_the_policy_grants_what_the_table_lists_and_what_every_node_has(node):
    assert granted(node) - listed(node) == (OWN if node == SUPERVISOR else OWN | LIFECYCLE)
    assert listed(node) - granted(node) == set()


class Untold(supervisor.Supervisor):
    """A supervisor that notes what it would have on the domain, and is not there."""

    def __init__(self, parameters):
        self.has = set()
        super().__init__(parameters)

    def create_publisher(self, kind, topic, qos):
        self.has.add(("publishes", topic, kind))

    def create_subscription(self, kind, topic, callback, qos):
        self.has.add(("subscribes", topic, kind))

    def create_client(self, kind, service):
        self.has.add(("calls", service, kind))

    def create_timer(self, period_s, callback, clock):
        assert clock.clock_type == ClockType.STEADY_TIME


def test_the_table_of_the_supervisor_is_what_it_has(tmp_path, monkeypatch):
    monkeypatch.setattr(Node, "__init__", lambda self, name, namespace: None)
    monkeypatch.setattr(supervisor, "SupervisedProcess", lambda *_: None)
    settings = tmp_path / "p.yaml"
    settings.write_text("/stack_counter/counter: {ros__parameters: {result_json: true}}\n")
    has = {(SUPERVISOR, how, name, "/".join([*kind.__module__.split(".")[:2], kind.__name__]))
           for how, name, kind in Untold(settings).has}
    assert has == table([SUPERVISOR])


@pytest.mark.parametrize("node", EVERY)
def test_the_threat_model_names_whatever_a_stranger_can_reach(node):
    text = (ROOT / "docs" / "security.md").read_text()
    model = text[text.index("## What a hostile participant can do"):
                 text.index("## Four enclaves")]
    reachable = {name for how, name in listed(node) if how in ("subscribes", "serves", "offers")
                 and not name.startswith("/camera/")}
    assert {name for name in reachable if f"`{name}`" not in model} == set()
