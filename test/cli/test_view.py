# SPDX-License-Identifier: Apache-2.0
"""`stack-counter view` as a command; its server is tested with the nodes' other code."""

import sys

import pytest
from kits.command import run

from stack_counter.cli import main
from stack_counter.cli.view import _print_address


def test_what_is_missing_is_named_with_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    monkeypatch.delitem(sys.modules, "stack_counter.ros.viewer", raising=False)
    code, _, err = run(capsys, "view")
    assert code == 2 and "pip install 'stack_counter[view]'" in err


@pytest.mark.parametrize("port", ["-1", "65536", "http"])
def test_a_port_that_cannot_be_is_refused(capsys, port):
    with pytest.raises(SystemExit) as caught:
        main(["view", f"--port={port}"])
    assert caught.value.code == 2 and "expected 0 to 65535" in capsys.readouterr().err


@pytest.mark.parametrize("host, open_to_others", [
    ("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True), ("robot.plant", True)])
def test_who_can_connect_is_said(capsys, host, open_to_others):
    _print_address(host, 8765)
    out, err = capsys.readouterr()
    assert ":8765" in out and "foxglove.json" in out and "0.0.0.0" not in out
    assert ("no password" in err) == open_to_others
