# SPDX-License-Identifier: Apache-2.0
"""The command line: what it offers, and its small commands."""

import subprocess
import sys
from importlib.util import find_spec

import pytest
from kits.bags import bag
from kits.command import run

from stack_counter.cli import main
from stack_counter.eval.arguments import ADD_ARGUMENTS
from stack_counter.train.member import TrainConfig


def test_info_and_import(tmp_path, capsys):
    code, out, _ = run(capsys, "info", bag(tmp_path))
    assert code == 0 and "6 usable of 6" in out and "/tf  tf2_msgs/msg/TFMessage  18" in out
    assert run(capsys, "info", tmp_path / "none")[0] == 2
    assert run(capsys, "import", tmp_path / "none", tmp_path / "out")[0] == 2
    code, _, err = run(capsys, "import", tmp_path, tmp_path / "out")
    assert code == 3 and "no transforms.json" in err


def test_doctor_and_info_follow_the_settings_and_exit_3_where_there_is_no_count(tmp_path, capsys):
    path, settings = bag(tmp_path), tmp_path / "settings.yaml"
    code, out, _ = run(capsys, "doctor", path)
    assert code == 0 and out.endswith("nothing to change: this can be counted\n")
    settings.write_text("collector:\n  ros__parameters: {world_frame: map}\n")
    for command in ("doctor", "info"):
        code, out, _ = run(capsys, command, path, "--config", settings)
        assert code == 3 and "set world_frame to 'base_link'" in out
    settings.write_text("reconstructor:\n  ros__parameters: {min_views: 7}\n")
    code, out, _ = run(capsys, "doctor", path, "--config", settings)
    assert code == 3 and "1. 6 usable views; expected 7 or more (min_views)" in out
    assert run(capsys, "doctor", tmp_path / "none")[0] == 2


def test_import_of_pictures_without_poses_takes_a_reference(tmp_path, capsys):
    (tmp_path / "a.jpg").write_bytes(b"")
    code, _, err = run(capsys, "import", tmp_path, tmp_path / "out")
    assert code == 2 and "1 pictures and no transforms.json; expected --reference" in err
    code, _, err = run(capsys, "import", tmp_path, tmp_path / "out", "--reference", "aruco = 1")
    assert code == 2 and "expected 'A.jpg:x,y B.jpg:x,y to" in err
    (tmp_path / "transforms_train.json").write_text("{}")
    code, _, err = run(capsys, "import", tmp_path, tmp_path / "out")
    assert code == 3 and "expected a nerfstudio scene: rename one of transforms_train.json" in err
    (tmp_path / "transforms.json").write_text("{}")
    code, _, err = run(capsys, "import", tmp_path, tmp_path / "out", "--reference", "aruco = 1")
    assert code == 2 and "has poses in transforms.json" in err


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


def test_help_loads_no_heavy_library():
    """Building the parser, with the arguments of all commands, takes none of them."""
    code = ("import sys\nfrom stack_counter.cli.main import _make_parser\n_make_parser()\n"
            "print(*{'torch', 'open3d', 'matplotlib', 'rclpy', 'sapien', 'rosbags', 'foxglove', "
            "'transformers', 'trimesh', 'coacd', 'scipy', 'cv2'} & set(sys.modules))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize("kind", ADD_ARGUMENTS)
def test_every_evaluation_has_arguments_and_a_module(capsys, kind):
    with pytest.raises(SystemExit) as caught:
        main(["evaluate", kind, "--help"])
    assert caught.value.code == 0 and f"evaluate {kind}" in capsys.readouterr().out
    assert find_spec(f"stack_counter.eval.{kind}")


def test_the_epochs_that_help_names_are_those_of_training(capsys):
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    assert f"(default {TrainConfig.epochs})" in capsys.readouterr().out


def test_help_lists_what_may_be_chosen(capsys):
    with pytest.raises(SystemExit):
        main(["replay", "--help"])
    out = capsys.readouterr().out
    assert all(name in out for name in ("network", "depth_corrected", "prior", "direct"))


@pytest.mark.parametrize("command", [("run",), ("view",), ("replay", "bag")])
def test_a_settings_file_that_is_not_there_is_named(tmp_path, capsys, command):
    code, _, err = run(capsys, *command, "--config", tmp_path / "nosuch")
    assert code == 2 and err.startswith("stack-counter: no settings file") and "nosuch" in err
