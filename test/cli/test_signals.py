# SPDX-License-Identifier: Apache-2.0
"""Commands that are ended by a signal leave no process behind."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh
from kits.survivors import descendants, wait_for_end, wait_until

from stack_counter.ros.private_domain import PrivateDomain

DOMAIN = PrivateDomain()
ROOT = Path(__file__).parents[2]


def start(folder, *arguments):
    """Starts `stack-counter` in the repository's root; what it prints goes to a file."""
    with open(folder / "log", "w") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "stack_counter", *arguments], stdout=log,
            stderr=subprocess.STDOUT, cwd=ROOT,
            env={**os.environ, **DOMAIN.environment})


def end(process, number, children):
    """Sends a signal once so many processes were started; returns the exit code."""
    try:
        wait_until(lambda: len(descendants(process.pid)) >= children, f"{children} processes")
        started = descendants(process.pid)
        process.send_signal(number)
        code = process.wait(60)
    finally:
        process.kill()
    wait_for_end(started)
    return code


@pytest.mark.parametrize("command", ["replay", "run"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_node_outlives_its_command(tmp_path, command, number):
    pytest.importorskip("rclpy")
    arguments = {"replay": ("replay", "bags/demo", "--part", "demo_nut"), "run": ("run",)}[command]
    code = end(start(tmp_path, *arguments), number, 3)
    assert code in ((-number,) if number == signal.SIGKILL else (0, 130))
    # A node that is interrupted while Python itself starts prints where, behind its name.
    assert "\nTraceback" not in "\n" + (tmp_path / "log").read_text()


@pytest.mark.parametrize("words", [("stack_counter", "--version"),
                                   ("stack_counter.nodes", "collector")])
def test_an_interrupt_while_libraries_load_prints_nothing(words):
    code = ("import runpy, sys\n"
            "class Interrupt:\n"
            "    def find_spec(self, name, *_):\n"
            "        if name == 'numpy':\n"
            "            raise KeyboardInterrupt\n"
            "sys.meta_path.insert(0, Interrupt())\n"
            "runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)\n")
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True,
                          cwd=ROOT, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_part_add_that_is_terminated_leaves_nothing(tmp_path):
    mesh = tmp_path / "block.stl"
    trimesh.creation.box((30.0, 20.0, 20.0)).export(mesh)
    code = end(start(tmp_path, "part", "add", "block", "--mesh", str(mesh), "--workers", "2",
                     "--catalogue", str(tmp_path / "parts.yaml")), signal.SIGTERM, 3)
    assert code == 130
    printed = (tmp_path / "log").read_text()
    assert "leaked" not in printed and "Traceback" not in printed
