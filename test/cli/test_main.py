# SPDX-License-Identifier: Apache-2.0
"""The command line: what it offers, and its small commands."""

import pytest
from kits.bags import bag
from kits.command import run

from stack_counter.cli import main


def test_info_and_import(tmp_path, capsys):
    code, out, _ = run(capsys, "info", bag(tmp_path))
    assert code == 0 and "6 usable of 6" in out and "/tf  tf2_msgs/msg/TFMessage  18" in out
    assert run(capsys, "info", tmp_path / "none")[0] == 2
    assert run(capsys, "import", tmp_path / "none", tmp_path / "out")[0] == 2
    code, _, err = run(capsys, "import", tmp_path, tmp_path / "out")
    assert code == 3 and "no transforms.json" in err


@pytest.mark.parametrize("arguments", [[], ["no_such"], ["part"], ["evaluate", "no_such"],
                                       ["simulate", "--scenes", "0"], ["replay"]])
def test_a_wrong_command_line_exits_2(capsys, arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2 and "usage: stack-counter" in capsys.readouterr().err


def test_arguments_of_a_module_are_loaded_with_its_command(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["evaluate", "volume", "--help"])
    assert caught.value.code == 0 and "--scenes" in capsys.readouterr().out
