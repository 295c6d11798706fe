# SPDX-License-Identifier: Apache-2.0
"""What `make setup-cell` installs suffices to count, and what it leaves out is named."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from stack_counter.errors import ConfigError, naming_missing_packages

ROOT = Path(__file__).parents[1]
SETUP = runpy.run_path(str(ROOT / "setup.py"), run_name="lists")
# What a cell lacks is not found, as if it were not installed.
RUN = """
import sys
from importlib.machinery import PathFinder

class Installed(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name not in sys.argv[1].split(","):
            return PathFinder.find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Installed
from stack_counter.cli import main
sys.exit(main(sys.argv[2:]))"""
LEFT_OUT = ("torch", "sapien", "coacd", "manifold3d", "matplotlib", "onnx", "transformers",
            "pycolmap", "pyarrow", "ray", "foxglove", "cascadio", "yourdfpy")


def run_in_cell(*arguments):
    return subprocess.run([sys.executable, "-c", RUN, ",".join(LEFT_OUT), *arguments],
                          capture_output=True, text=True, cwd=ROOT)


def test_a_cell_leaves_torch_out_and_has_another_open3d():
    cell, everything = SETUP["cell_requires"](), SETUP["REQUIRES"]
    names = {line.split(">=")[0] for line in cell}
    assert "torch" not in names and "open3d-cpu" in names and "open3d" not in names
    assert set(everything) - set(cell) == {
        line for line in everything if line.startswith(("torch", "open3d"))}
    assert set(SETUP["CELL_REPLACES"]) <= {line.split(">=")[0] for line in everything}


def test_a_bag_is_counted_without_torch_and_simulation():
    done = run_in_cell("replay", "bags/demo", "--part", "demo_nut", "--direct")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("count      1") and "said by network" in done.stdout


@pytest.mark.parametrize("arguments, package", [
    (("simulate", "--scenes", "1", "--out", "none"), "manifold3d"),
    (("train", "--data", "none", "--out", "none"), "torch")])
def test_what_a_cell_lacks_is_named_in_one_line(arguments, package):
    done = run_in_cell(*arguments)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert f"this takes the package {package}, which is not installed" in done.stderr
    assert "make clean setup" in done.stderr


def test_an_arrangement_is_refused_before_anything_is_counted(tmp_path):
    done = run_in_cell("replay", "bags/demo", "--part", "demo_nut", "--direct", "--report",
                       str(tmp_path / "out"), "--arrangement")
    assert done.returncode == 2 and done.stdout == "" and len(done.stderr.splitlines()) == 1
    assert "--arrangement takes the package sapien, which is not installed" in done.stderr


def test_a_module_that_is_missing_by_a_defect_is_none_of_the_user_s():
    with pytest.raises(ModuleNotFoundError), naming_missing_packages():
        __import__("stack_counter.no_such_module")
    with pytest.raises(ConfigError, match="torch"), naming_missing_packages():
        raise ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn")
