# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a live graph itself: quality of service, nodes that do nothing, clocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.views.checkup.checkup import Checkup
from stack_counter.views.checkup.diagnosis import SETTINGS
from stack_counter.views.checkup.findings import Finding, Severity

COLLECTOR = f"{NAMESPACE}/collector"
_BEST_EFFORT = "best effort, and it asks for reliable"
NOT_RUNNING, NO_ANSWER, ACTIVE = "not running", "no answer", "active"


# Full name of an endpoint's node, and the quality of service that it offers or asks for.
Ends = Sequence[tuple[str, QoSProfile]]


def qos_findings(topics: Mapping[str, tuple[Ends, Ends]]) -> list[Finding]:
    """Subscribers that do not hear a publisher for want of its quality of service.

    Args:
        topics: publishers and subscribers by topic.
    """
    unheard: dict[tuple[str, str, str], list[str]] = {}
    for topic, (publishers, subscribers) in topics.items():
        for publisher, offered in publishers:
            for subscriber, asked in subscribers:
                if qos_check_compatible(offered, asked)[0] == QoSCompatibility.ERROR:
                    key = subscriber, publisher, _difference(offered, asked)
                    unheard.setdefault(key, []).append(topic)
    return [Finding(Severity.STOPS if subscriber == COLLECTOR else Severity.HARMS,
                    f"{subscriber} hears nothing on {', '.join(dict.fromkeys(names))}: "
                    f"{publisher} publishes {difference}",
                    _qos_remedy(subscriber, publisher, difference))
            for (subscriber, publisher, difference), names in unheard.items()]


def _difference(offered: QoSProfile, asked: QoSProfile) -> str:
    """What is offered that is less than what is asked for."""
    if (offered.reliability, asked.reliability) \
            == (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE):
        return _BEST_EFFORT
    if asked.durability == DurabilityPolicy.TRANSIENT_LOCAL != offered.durability:
        return "volatile, and it asks for transient_local"
    return "with another quality of service than it asks for"


def _qos_remedy(subscriber: str, publisher: str, difference: str) -> str:
    if difference == _BEST_EFFORT and subscriber == COLLECTOR:
        return "set reliable: false for the collector, or have the driver publish reliable"
    return f"give {publisher} the quality of service that {subscriber} asks for"


def node_findings(states: Mapping[str, str]) -> list[Finding]:
    """Nodes of this package that do not work.

    Args:
        states: name of its lifecycle's state by node; else `NOT_RUNNING` or `NO_ANSWER`.
    """
    if set(states.values()) == {NOT_RUNNING}:
        return [Finding(Severity.HARMS, f"none of {', '.join(states)} runs",
                        "start them: stack-counter run")]
    return [Finding(Severity.STOPS, f"the node {NAMESPACE}/{node} is {state}; expected {ACTIVE}",
                    "start it: stack-counter run" if state == NOT_RUNNING else
                    "end it and start it again" if state == NO_ANSWER else
                    f"see its log for what it lacks, then ros2 lifecycle set {NAMESPACE}/{node} "
                    + ("activate" if state == "inactive" else "configure, then activate"))
            for node, state in states.items() if state != ACTIVE]


def clock_findings(check: Checkup) -> list[Finding]:
    """Stamps that are far from this machine's clock: of cameras, and of TF."""
    delays = {stream.topic: stream.delay_s for stream in check.streams.values()
              if stream.content in ("color", "depth") and stream.stamps}
    delays |= {"/tf": check.tf.delay_s} if check.tf.delays else {}
    off = {topic: delay for topic, delay in delays.items() if abs(delay) > SETTINGS.clocks_s}
    if not off:
        return []
    seen = ", ".join(f"{topic} {abs(delay):.1f} s {'behind' if delay > 0 else 'ahead'}"
                     for topic, delay in off.items())
    return [Finding(Severity.HARMS, f"stamps are far from this machine's clock: {seen}; expected "
                    f"{SETTINGS.clocks_s:g} s or less",
                    "synchronise the clocks (chrony, ptp); for a simulation or a bag that is "
                    "played, publish /clock and set use_sim_time")]
