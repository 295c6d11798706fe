# SPDX-License-Identifier: Apache-2.0
"""When a process that ends is started again, and how processes are stopped."""

import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from stack_counter.config import Config
from stack_counter.ros import processes
from stack_counter.ros.processes import SETTINGS, NodeError, NodeProcesses, SupervisedProcess


@pytest.fixture
def clock(monkeypatch):
    """The time, which stands still unless a test sets it."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


class Starts(list):
    """Processes that were started in place of nodes; each ends when its code is set."""

    def __call__(self, name, parameters, environment, output, ros_arguments):
        process = SimpleNamespace(stdout=[], returncode=None, name=name)
        process.poll = lambda: process.returncode
        self.append(process)
        return process


@pytest.fixture
def starts(monkeypatch):
    made = Starts()
    monkeypatch.setattr(processes, "_start_node", made)
    return made


def test_each_death_in_a_row_doubles_the_pause(clock, starts, tmp_path):
    process = SupervisedProcess("counter", tmp_path)
    assert process.take_death() == "" and process.running
    pauses = []
    for number in range(1, 8):
        starts[-1].returncode = -9 if number == 1 else 2
        assert process.take_death() == ("signal 9" if number == 1 else "exit code 2")
        assert process.take_death() == "" and not process.running
        pauses.append(process.restart_at - clock[0])
        process.restart_if_due()
        assert len(starts) == number  # not yet
        clock[0] = process.restart_at
        process.restart_if_due()
        assert len(starts) == number + 1 and process.running and process.restarts == number
    assert pauses == [1, 3, 7, 15, SETTINGS.max_restart_pause_s, SETTINGS.max_restart_pause_s,
                      SETTINGS.max_restart_pause_s]


def test_a_process_that_ran_long_starts_again_at_once(clock, starts, tmp_path):
    process = SupervisedProcess("counter", tmp_path)
    starts[-1].returncode = 1
    process.take_death()
    clock[0] = process.restart_at
    process.restart_if_due()
    clock[0] += SETTINGS.stable_after_s + 1
    starts[-1].returncode = 1
    assert process.take_death() and process.restart_at == clock[0]


def test_a_process_that_ignores_sigterm_is_killed(monkeypatch):
    monkeypatch.setattr(processes, "SETTINGS", processes.ProcessSettings(stop_timeout_s=0.5))
    code = "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n" \
           "print('up', flush=True)\ntime.sleep(60)"
    stubborn = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert stubborn.stdout.readline() == "up\n"
    processes._stop_processes([stubborn])
    assert stubborn.returncode == -signal.SIGKILL
    stubborn.stdout.close()


def test_a_node_that_has_ended_is_an_error_with_its_last_line(monkeypatch):
    def start(name, parameters, environment, output):
        return subprocess.Popen([sys.executable, "-c", f"print('{name} is lost'); exit(4)"],
                                stdout=output)

    monkeypatch.setattr(processes, "_start_node", start)
    with NodeProcesses(Config(), {}) as nodes:
        for process in nodes._processes.values():
            process.wait()
        with pytest.raises(NodeError, match="node collector ended with 4.*counter is lost"):
            nodes.check()
