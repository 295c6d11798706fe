# SPDX-License-Identifier: Apache-2.0
"""The scale of a live node, by a clock that is set; no node is started."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from std_msgs.msg import Float64

from stack_counter.config import CounterConfig
from stack_counter.nodes.scale import Scale
from stack_counter.weighing.joined_count import Weighing

CONFIG = CounterConfig(weight_topic="/scale/weight", tare_kg=1.0, weight_max_age_s=5.0)


def scale_of(config):
    """The scale, what a message on its topic calls, and a function that sets the time, s."""
    now, topics = [0], {}
    clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=now[0]))
    node = SimpleNamespace(steady=clock, subscribe=lambda kind, topic, callback, qos:
                           topics.update({topic: callback}))
    return Scale(node, config), topics, lambda seconds: now.__setitem__(0, round(1e9 * seconds))


def test_a_volume_gets_the_newest_stable_weight():
    scale, topics, set_time = scale_of(CONFIG)
    assert scale.weighing(CONFIG) == Weighing(None, 0.005)
    for tenth in range(30):
        set_time(tenth / 10)
        topics["/scale/weight"](Float64(data=3.0 if tenth < 20 else 3.0 + tenth / 10))
    assert scale.weighing(CONFIG).net_kg == pytest.approx(2.0)
    assert scale.weighing(replace(CONFIG, tare_kg=0.5)).net_kg == pytest.approx(2.5)
    set_time(20.0)
    assert scale.weighing(CONFIG).net_kg is None, "its last word is 17 s old"


def test_without_a_topic_there_is_no_scale_but_a_number_may_be_set():
    scale, topics, _ = scale_of(CounterConfig())
    assert not topics and scale.weighing(CounterConfig()) is None
    assert scale.weighing(CounterConfig(weight_kg=2.0)) == Weighing(2.0, 0.005)
