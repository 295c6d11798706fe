# SPDX-License-Identifier: Apache-2.0
"""Who asks for security is not given a start without it."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from stack_counter.cli import main
from stack_counter.errors import ConfigError
from stack_counter.ros import processes, security


@pytest.fixture(autouse=True)
def asked_for(monkeypatch):
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.delenv("ROS_SECURITY_KEYSTORE", raising=False)


@pytest.mark.parametrize("wheels, keystore, said", [
    (True, "", "Python wheels"), (True, "/keys", "Python wheels"),
    (False, "", "ROS_SECURITY_KEYSTORE names no keystore"), (False, "/keys", None)])
def test_a_start_without_protection_is_refused(monkeypatch, wheels, keystore, said):
    monkeypatch.setattr(security, "find_spec", lambda name: wheels or None)
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", keystore)
    if said is None:
        security.check_security()
    else:
        with pytest.raises(ConfigError, match=said):
            security.check_security()


@pytest.mark.parametrize("value", [None, "", "false"])
def test_nothing_is_asked_of_who_asks_for_nothing(monkeypatch, value):
    monkeypatch.delenv("ROS_SECURITY_ENABLE")
    if value is not None:
        monkeypatch.setenv("ROS_SECURITY_ENABLE", value)
    security.check_security()


def test_a_node_ends_with_one_line():
    done = subprocess.run([sys.executable, "-m", "stack_counter.nodes.counter"],
                          capture_output=True, text=True, env=os.environ)
    assert done.returncode == 1
    assert done.stderr.startswith("ROS_SECURITY_ENABLE is true, but ")
    assert done.stderr.count("\n") == 1


def test_run_exits_2_with_the_same_line(capsys):
    assert main(["run"]) == 2
    assert capsys.readouterr().err.startswith("stack-counter: ROS_SECURITY_ENABLE is true, but ")


def test_run_puts_each_node_into_its_enclave_unless_another_is_given(monkeypatch, tmp_path):
    given = []
    monkeypatch.setattr(processes, "_start_node", lambda *arguments: given.append(
        arguments[-1]) or SimpleNamespace(stdout=[]))
    for node in (*processes.NODES, "supervisor"):
        assert security.enclave_arguments(node) == ["--enclave", f"/stack_counter/{node}"]
    processes.SupervisedProcess("counter", tmp_path, ["--enclave", "/mine"])
    monkeypatch.delenv("ROS_SECURITY_ENABLE")
    processes.SupervisedProcess("counter", tmp_path, ["-r", "a:=b"])
    # Of two, ROS takes the last.
    assert given == [["--enclave", "/stack_counter/counter", "--enclave", "/mine"], ["-r", "a:=b"]]
