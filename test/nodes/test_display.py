# SPDX-License-Identifier: Apache-2.0
"""When what RViz and Foxglove show is published."""

import numpy as np
import pytest

from stack_counter.nodes.display import Display
from stack_counter.ros.standard_messages import to_header
from stack_counter.types import Container, Mesh, StackVolume, ViewTally

HEADER = to_header(5, "cell")
REGION = (np.array([-0.1, -0.1, 0.0]), np.array([0.1, 0.1, 0.2]))
VOLUME = StackVolume(5, 1e-3, 1e-5, Container("none", np.eye(4)), (0, 0, 0), 1.0, None, None, None,
                     ViewTally(), mesh=Mesh(np.eye(3, dtype=np.float32),
                                            np.array([[0, 1, 2]], np.int32)))


class Publisher:
    """Remembers what is published; has as many subscribers as the test sets."""

    def __init__(self):
        self.sent, self.subscribers = [], 0
        self.publish = self.sent.append

    def get_subscription_count(self):
        return self.subscribers


class Node:
    """Hands out such publishers."""

    def __init__(self):
        self.of = {}

    def add_timer(self, period_s, callback):
        self.pass_time = callback

    def advertise(self, kind, topic, qos):
        assert qos.depth == 1  # a history of such messages would fill the memory
        return self.of.setdefault(topic, Publisher())


class Stack:
    """A scan without views."""

    regions, views = [REGION], []


@pytest.fixture
def clock(monkeypatch):
    """The time, which stands still unless it is set."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


def test_a_running_result_is_shown_only_to_who_looks_and_a_final_one_always(clock):
    node = Node()
    display = Display(node)
    markers, cloud = node.of["markers"], node.of["surface"]

    def show(shown, final):
        display.show_scan(Stack(), shown, HEADER, final)
        node.pass_time()
        return len(markers.sent), len(cloud.sent)

    assert show([VOLUME], final=False) == (0, 0)
    cloud.subscribers = 1
    assert show([VOLUME], final=False) == (0, 1) and cloud.sent[0].width == 3
    cloud.subscribers, markers.subscribers = 0, 1
    assert show([VOLUME], final=False) == (1, 1)
    markers.subscribers = 0
    assert show([VOLUME], final=True) == (2, 2)
    assert show([], final=True) == (3, 3)
    assert [m.ns for m in markers.sent[-1].markers] == ["", "region"] and not cloud.sent[-1].width


def test_showing_leaves_most_of_the_time_to_counting(clock):
    node = Node()
    display = Display(node)
    markers = node.of["markers"]
    markers.subscribers = 1

    def publish(message):
        clock[0] += 1.0
        markers.sent.append(message)

    def shown(at, final=False):
        clock[0] = at
        display.show_scan(Stack(), [VOLUME], HEADER, final)
        node.pass_time()
        return len(markers.sent)

    markers.publish = publish
    assert [shown(100.0), shown(104.9), shown(105.1)] == [1, 1, 2]
    assert shown(107.0, final=True) == 3  # it is the last one: nothing waits for it


def test_what_is_newest_is_shown_once():
    node = Node()
    display = Display(node)
    node.pass_time()
    display.show_scan(Stack(), [VOLUME], HEADER, final=True)
    display.show_scan(Stack(), [], HEADER, final=True)
    assert not node.of["markers"].sent  # counting comes first
    node.pass_time()
    node.pass_time()
    assert [len(m.markers) for m in node.of["markers"].sent] == [2]
