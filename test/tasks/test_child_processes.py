# SPDX-License-Identifier: Apache-2.0
"""Children end with their parent, in whatever way that ends."""

import os
import signal
import subprocess
import sys
from multiprocessing import util

import pytest
from kits.survivors import is_running, wait_for_end

from stack_counter.tasks.child_processes import ENDS_WITH_STDIN, worker_pool

CHILD = "import time, {0} as c; c.end_with_parent(); print('up', flush=True); time.sleep(60)"
# Starts a child as nodes are started, tells its id once it is up, and waits.
PARENT = """
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdin=subprocess.PIPE,
                         stdout=subprocess.PIPE, text=True)
assert child.stdout.readline().strip() == "up"
print(child.pid, flush=True)
time.sleep(60)
"""
POOL = """
import os, time
from {0} import worker_pool
if __name__ == "__main__":
    with worker_pool(2) as pool:
        print(*[job.result() for job in [pool.submit(os.getpid) for _ in range(2)]], flush=True)
        pool.submit(time.sleep, 60)
        time.sleep(60)
"""
MODULE = "stack_counter.tasks.child_processes"


def start(tmp_path, code, *arguments):
    """Starts Python on a program that prints ids of its children; returns it and these."""
    (tmp_path / "program.py").write_text(code)
    process = subprocess.Popen([sys.executable, str(tmp_path / "program.py"), *arguments],
                               stdout=subprocess.PIPE, text=True,
                               env={**os.environ, ENDS_WITH_STDIN: "1"}, stdin=subprocess.PIPE)
    children = [int(word) for word in process.stdout.readline().split()]
    assert children and all(is_running(child) for child in children)
    return process, children


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_child_ends_with_a_parent_that_is_killed(tmp_path, number):
    parent, children = start(tmp_path, PARENT, CHILD.format(MODULE))
    parent.send_signal(number)
    assert parent.wait(10) == -number
    wait_for_end(children)


def test_a_child_that_ignores_sigterm_is_killed(tmp_path):
    stubborn = "import signal, dataclasses; signal.signal(signal.SIGTERM, signal.SIG_IGN); " \
        + CHILD.format(MODULE).replace("c.end", "c.SETTINGS = c.ChildProcessSettings(0.1); c.end")
    parent, children = start(tmp_path, PARENT, stubborn)
    parent.kill()
    parent.wait()
    wait_for_end(children)


def test_the_workers_of_a_pool_end_with_a_parent_that_is_killed(tmp_path):
    parent, children = start(tmp_path, POOL.format(MODULE))
    parent.kill()
    parent.wait()
    wait_for_end(children)


def test_an_error_ends_the_workers_of_a_pool_at_once():
    with pytest.raises(KeyboardInterrupt), worker_pool(1) as pool:
        worker = pool.submit(os.getpid).result()
        pool.submit(signal.pause)
        raise KeyboardInterrupt
    wait_for_end([worker])


def test_an_interrupt_while_a_worker_is_started_comes_after_it(monkeypatch, capfd):
    spawn, started = util.spawnv_passfds, []

    def interrupted_spawn(*arguments):
        started.append(spawn(*arguments))  # it reads next what its parent has still to write
        signal.raise_signal(signal.SIGINT)
        return started[-1]

    monkeypatch.setattr(util, "spawnv_passfds", interrupted_spawn)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a test may run without
    try:
        with pytest.raises(KeyboardInterrupt), worker_pool(1) as pool:
            pool.submit(os.getpid)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    wait_for_end(started[-1:])
    assert "Traceback" not in capfd.readouterr().err


def test_workers_ignore_what_their_parent_ignores():
    """As in the background of a script, where an interrupt is meant for others."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with worker_pool(1) as pool:
            assert pool.submit(signal.getsignal, signal.SIGINT).result() == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
