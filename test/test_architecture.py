"""Who may import what: the core knows no ROS, no bags and no simulator (CONTRIBUTING.md)."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "stack_counter"

ROS = {"rclpy", "rosidl_runtime_py", "ament_index_python", "tf2_ros", "launch", "launch_ros"}
BAGS = {"mcap", "mcap_ros2", "rosbags", "rosbag2_py"}
ENGINES = {"sapien", "pybullet", "mujoco", "coacd", "manifold3d"}
# Parts beside the core.
OUTER = {"bag", "nodes", "sim", "train", "eval", "part", "cli", "cli_container", "cli_part",
         "__main__"}

# Part -> which other parts of the package (or modules of them) it may use besides the core, and
# which of the libraries named above.
PARTS = {
    "core": (set(), set()),
    "bag": (set(), BAGS),
    "bag/player": ({"bag"}, BAGS | ROS | {"messages"}),
    "nodes": ({"bag.recorder"}, ROS | {"messages"}),  # the collector records its scans
    "sim": ({"bag"}, ENGINES),
    "train": ({"bag", "sim"}, set()),
    "part": ({"bag", "sim", "train"}, set()),
    "eval": ({"bag", "sim", "train", "part"}, set()),
    "cli": (OUTER, set()),
}
# Sim writes recordings and eval reads them, both through bag's public functions. Of sim and train
# the others see what the package's `__init__` names, not its modules. Only the command line puts
# parts together.
CLOSED = {"sim", "train", "eval", "part"}


def part_of(path: Path) -> str:
    """Part of the package that a file, relative to the package, belongs to."""
    name = path.with_suffix("").as_posix()
    if name in ("cli", "cli_container", "cli_part", "__main__"):
        return "cli"
    if name in PARTS:
        return name
    folder = path.parts[0] if len(path.parts) > 1 else ""
    return folder if folder in PARTS else "core"


def imported(tree: ast.AST, path: Path) -> set[str]:
    """Dotted names that a module imports, relative imports resolved, at any depth of the code."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                package = ("stack_counter", *path.parent.parts)
                base = ".".join([*package[:len(package) - node.level + 1], *filter(None, [base])])
            names |= {f"{base}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant) \
                and getattr(node.func, "attr", getattr(node.func, "id", "")) \
                in ("import_module", "__import__"):
            names.add(str(node.args[0].value))
    return names


def violations(source: str, path: Path) -> list[str]:
    """Imports of a module that its part of the package may not have."""
    part = part_of(path)
    parts, libraries = PARTS[part]
    found = []
    for name in sorted(imported(ast.parse(source), path)):
        top, _, rest = name.partition(".")
        if top == "stack_counter":
            inner, module = rest.split(".")[0], ".".join(rest.split(".")[:2])
            if inner in OUTER and inner != part.split("/")[0] and not {inner, module} & parts:
                found.append(name)
            elif inner in CLOSED and inner != part and part != "cli" \
                    and (PACKAGE / inner / f"{rest.split('.')[1]}.py").exists():
                found.append(name)
            if part == "bag" and rest.startswith("bag.player"):  # would bring rclpy in
                found.append(name)
        elif top.endswith(("_msgs", "_srvs", "_interfaces")):
            if "messages" not in libraries:
                found.append(name)
        elif top in ROS | BAGS | ENGINES and top not in libraries:
            found.append(name)
    return found


MODULES = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_imports_are_allowed(path):
    assert violations((PACKAGE / path).read_text(), path) == [], \
        f"{path} belongs to '{part_of(path)}'"


@pytest.mark.parametrize("path, line", [
    ("tsdf.py", "import rclpy"),
    ("volume.py", "def f():\n    from sensor_msgs.msg import Image"),
    ("pipeline.py", "import mcap.reader"),
    ("pipeline.py", "from stack_counter.bag import reader"),
    ("pipeline.py", "from . import nodes"),
    ("segmentation/depth.py", "from ..sim import piles"),
    ("segmentation/depth.py", "import rosbags"),
    ("occupancy.py", "import importlib\nimportlib.import_module('sapien')"),
    ("bag/reader.py", "import rclpy.node"),
    ("bag/reader.py", "from stack_counter.bag.player import play"),
    ("bag/player.py", "from stack_counter.nodes import collector"),
    ("bag/recorder.py", "from stack_counter.nodes.base import run"),
    ("nodes/collector.py", "import mcap"),
    ("nodes/collector.py", "from stack_counter.bag import reader"),
    ("nodes/collector.py", "from stack_counter.bag.recording import Recording"),
    ("nodes/counter.py", "import stack_counter.bag.player"),
    ("nodes/counter.py", "from stack_counter.sim import piles"),
    ("sim/piles.py", "import stack_counter.train.model"),
    ("sim/piles.py", "from stack_counter import eval"),
    ("train/fit.py", "from stack_counter.sim.piles import drop"),
    ("eval/report.py", "from stack_counter.train.baselines import fit"),
    ("eval/report.py", "from stack_counter.cli import main"),
])
def test_a_violation_is_noticed(path, line):
    assert violations(line, Path(path))


@pytest.mark.parametrize("path, line", [
    ("tsdf.py", "import numpy, open3d\nfrom stack_counter.types import View"),
    ("bag/reader.py", "import mcap.reader\nfrom stack_counter.errors import BagError"),
    ("bag/player.py", "import rclpy\nfrom std_srvs.srv import Trigger\nfrom .reader import read"),
    ("nodes/counter.py", "import rclpy\nfrom stack_counter.nodes import conversions"),
    ("nodes/recording.py", "from stack_counter.bag.recorder import Recorder"),
    ("sim/piles.py", "import sapien\nfrom stack_counter.sim import shapes"),
    ("cli.py", "from stack_counter.nodes import collector\nfrom stack_counter.sim import piles"),
])
def test_what_is_allowed_passes(path, line):
    assert violations(line, Path(path)) == []


def test_the_core_loads_no_ros_bags_or_engine():
    """The whole core, imported in a fresh interpreter, pulls in none of them, even indirectly."""
    names = ["stack_counter." + ".".join(path.with_suffix("").parts) for path in MODULES
             if part_of(path) == "core" and path.name != "__init__.py"]
    assert (ROS | BAGS | ENGINES) & loaded(*names) == set()


def test_the_recorder_brings_no_ros_and_no_player_into_the_nodes():
    got = loaded("stack_counter.bag.recorder")
    assert (ROS | ENGINES) & got == set()
    assert {name for name in got if name.startswith("stack_counter.bag.")} == {
        f"stack_counter.bag.{module}" for module in ("recorder", "recording", "record_names")}


def loaded(*names):
    """All modules that a fresh interpreter has loaded after importing these."""
    code = "import importlib, json, sys\n" \
           "for name in sys.argv[1:]: importlib.import_module(name)\n" \
           "print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code, *names], capture_output=True, text=True,
                          cwd=PACKAGE.parent, timeout=120)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout))
