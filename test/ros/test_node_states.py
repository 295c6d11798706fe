# SPDX-License-Identifier: Apache-2.0
"""`stack-counter doctor --nodes`, by which a container's health is checked, over real DDS."""

import re
import signal

import pytest

pytest.importorskip("rclpy")

from kits.command import run
from kits.harness import Harness
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState

NAMES = ("collector", "reconstructor", "counter")
DEACTIVATE = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))


@pytest.fixture
def ros(tmp_path):
    harness = Harness(tmp_path)
    yield harness
    harness.close()


def state_in(ros, name):
    answer = ros.call_until_answered(GetState, f"/stack_counter/{name}/get_state")
    return answer.current_state.label


def test_health_fails_unless_all_three_nodes_are_active(ros, capsys):
    code, out, error = run(capsys, "doctor", "--nodes")
    assert code == 3 and "none of collector, reconstructor, counter runs" in error

    nodes = {name: ros.start(name, **({"estimator": "prior"} if name == "counter" else {}))
             for name in NAMES}
    ros.wait(lambda: all(state_in(ros, name) == "active" for name in NAMES), "active nodes")
    code, out, _ = run(capsys, "doctor", "--nodes")
    assert code == 0 and out == "collector active, reconstructor active, counter active\n"

    # A node that stands still, as one that computes for ever.
    nodes["reconstructor"].send_signal(signal.SIGSTOP)
    code, _, error = run(capsys, "doctor", "--nodes")
    nodes["reconstructor"].send_signal(signal.SIGCONT)
    assert code == 3 and re.search("/stack_counter/reconstructor is no(t running| answer)", error)

    ros.call(ChangeState, "/stack_counter/collector/change_state", DEACTIVATE)
    code, _, error = run(capsys, "doctor", "--nodes")
    assert code == 3 and "/stack_counter/collector is inactive; expected active" in error

    ros.processes.remove(nodes["collector"])
    nodes["collector"].kill()
    nodes["collector"].wait()
    code, _, error = run(capsys, "doctor", "--nodes")
    assert code == 3 and "/stack_counter/collector is " in error


def test_nodes_and_a_bag_are_not_asked_for_at_once(capsys):
    with pytest.raises(SystemExit):
        run(capsys, "doctor", "bags/demo", "--nodes")
    assert "not allowed with argument" in capsys.readouterr().err
