# SPDX-License-Identifier: Apache-2.0
"""Quality of service of every topic of the three nodes."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

# Reliable everywhere: best effort loses images even on one machine.
RELIABLE = QoSProfile(depth=100, history=HistoryPolicy.KEEP_LAST,
                      reliability=ReliabilityPolicy.RELIABLE)
# Depth at which a running volume of the continuous mode is not overwritten before it is delivered.
_RUNNING_DEPTH = 20


def latched(regions: int) -> QoSProfile:
    """Returns the profile of a latched topic with a message for each of so many named regions.

    It gives its last messages to whoever subscribes later: those of all regions.
    """
    return QoSProfile(depth=max(_RUNNING_DEPTH, 2 * regions),
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)


# Latched, but the last one only: a result, or what is shown; it replaces the one before.
LATCHED_NEWEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# What a scan is at, which whoever comes late needs to know as well; and for readers of a latched
# topic that must not lose any message of it, in live mode as well.
LATCHED_ALL = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DIAGNOSTICS = QoSProfile(depth=10)
# Of a node's heartbeat: the middleware itself says that the process lives, also while the node
# computes. Who subscribes with this profile is told within the lease when it does not. Chosen:
# half of the 4 s in which a manager is to notice.
HEARTBEAT = QoSProfile(depth=1, liveliness=LivelinessPolicy.AUTOMATIC,
                       liveliness_lease_duration=Duration(seconds=2))
# The topics of final counts. Both carry the same: `count` is what `result` was called, and goes
# with the next release.
FINAL_TOPICS = ("result", "count")
# The topic that has them as flat JSON, if the counter's parameter of this name says so.
RESULT_JSON = "result_json"


def profile_that_hears(publishers: Sequence[QoSProfile]) -> QoSProfile:
    """Returns the profile of a subscription that hears publishers of all these profiles.

    It is reliable if all of them are, and gets the last messages of those that are latched if
    all of them are.
    """
    reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
    latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
    return QoSProfile(
        depth=100,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def record_qos(topic: str, kind: str) -> QoSProfile:
    """Returns the profile that a recorded topic of a type is played with."""
    if topic == "/tf_static":
        return LATCHED_ALL
    return QoSProfile(depth=50 if kind.endswith(("Image", "CameraInfo")) else 1000)
