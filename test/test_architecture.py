# SPDX-License-Identifier: Apache-2.0
"""Who may import what: one table, a ladder in which no circle can be written (CONTRIBUTING.md)."""

import ast
import configparser
import graphlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "stack_counter"

# The ground: each may import those before it.
GROUND = ("errors", "types", "config", "geometry", "files", "images", "pretrained", "inference",
          "counting", "weighing", "tasks")
# Package -> which others it may import besides the ground; only what stands above it here.
LAYERS = {
    "lean_open3d": (), "views": ("lean_open3d",), "fusion": ("lean_open3d",), "display": (),
    "occupancy": (), "visible_parts": ("occupancy",), "picture_baselines": ("occupancy",),
    "container": ("fusion",),
    "segmentation": ("fusion", "container"),
    "multiview": ("fusion", "segmentation"),
    "reconstruction": ("views.checkup", "fusion", "container", "segmentation", "multiview",
                       "display"),
    "parts": ("fusion", "occupancy", "reconstruction"),
    "stack_count": ("occupancy", "visible_parts", "parts"),
    "pipeline": ("container", "segmentation", "multiview", "occupancy", "reconstruction",
                 "parts", "stack_count"),
    "region_counters": ("pipeline",),
    "bag": ("views", "fusion", "segmentation", "occupancy", "visible_parts", "parts",
            "stack_count", "pipeline", "region_counters"),
    "archive": ("display", "occupancy", "parts", "bag"),
    "pictures": ("fusion", "bag"),
    "bridges": ("display",),
    "ros": ("views", "display", "bag", "bridges"),
    "nodes": ("views", "display", "occupancy", "visible_parts", "parts", "stack_count",
              "region_counters", "bag.recorder", "ros"),
    "sim": ("lean_open3d", "occupancy", "pipeline", "bag"),
    "teaching": ("lean_open3d", "fusion", "container", "occupancy", "parts", "pipeline", "bag",
                 "sim"),
    "train": ("fusion", "container", "occupancy", "visible_parts", "picture_baselines", "parts",
              "reconstruction", "pipeline", "sim"),
    "eval": ("lean_open3d", "views", "multiview", "display", "occupancy", "visible_parts",
             "picture_baselines", "parts", "reconstruction", "stack_count", "pipeline", "bag",
             "sim", "teaching"),
    "cli": ("*",),
}
FACES = {"sim", "teaching", "train"}  # of these the others import what their __init__ names
# Libraries -> the packages that may import them.
LIBRARIES = {
    r"rclpy|rosidl_runtime_py|ament_index_python|tf2_ros|launch|launch_ros": "ros nodes",
    r"\w+_msgs|\w+_srvs|\w+_interfaces": "ros nodes",
    r"foxglove": "ros",
    r"mcap|mcap_ros2|rosbags|rosbag2_py": "bag",
    r"open3d": "lean_open3d",
    r"yourdfpy": "views",
    r"small_gicp": "fusion visible_parts",
    r"tqdm": "tasks",
    r"pycolmap|PIL|pillow_heif": "pictures",
    r"torch": "pretrained occupancy picture_baselines segmentation train",
    r"imagesize": "views",
    r"onnx": "train",
    r"onnxruntime": "inference",
    r"sapien|coacd|manifold3d": "sim",
    r"matplotlib": "sim train eval",
    r"jinja2": "display archive",
    r"ray": "tasks",
    r"pyarrow": "archive",
    r"aiomqtt|paho|asyncua": "bridges",
}
ROS_AND_BAGS = ("rclpy", "mcap", "rosbags", "sapien", "coacd", "manifold3d")
MODULES = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))


def home_of(path: Path) -> str:
    """The entry of GROUND or LAYERS that a file, relative to the package, belongs to."""
    name = path.parts[0].removesuffix(".py")
    return "cli" if name == "__main__" else name


def imported_names(source: str, path: Path) -> set[str]:
    """Dotted names that a module imports, relative imports resolved, at any depth of the code."""
    names = set()
    for node in ast.walk(ast.parse(source)):
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


def may_import(home: str, name: str) -> bool:
    """Whether code of `home` may import `name`, a dotted name inside the package."""
    target, _, rest = name.partition(".")
    if target in (home, "__version__", ""):
        return True
    if target in GROUND:
        return home not in GROUND or GROUND.index(target) < GROUND.index(home)
    uses = LAYERS.get(home, ())
    if "*" in uses:
        return True
    inner = PACKAGE / target / rest.split(".")[0]
    if target in FACES and rest and (inner.is_dir() or inner.with_suffix(".py").exists()):
        return False
    return target in uses or any(name == use or name.startswith(f"{use}.") for use in uses)


def violations(source: str, path: Path) -> list[str]:
    """Imports of a module that the table does not allow."""
    home, found = home_of(path), []
    for name in sorted(imported_names(source, path)):
        top, _, rest = name.partition(".")
        if top == "stack_counter":
            if not may_import(home, rest):
                found.append(name)
        else:
            found += [name for libraries, homes in LIBRARIES.items()
                      if re.fullmatch(libraries, top) and home not in homes.split()]
    return found


def test_the_table_is_a_ladder():
    above = set()
    for name, uses in LAYERS.items():
        assert {use.split(".")[0] for use in uses} <= above | {"*"}
        above.add(name)


def test_the_table_names_every_file():
    assert {home_of(path) for path in MODULES} == {*GROUND, *LAYERS, "__init__"}


def module_name(path: Path) -> str:
    """Dotted name of a file, relative to the package."""
    name = ".".join(("stack_counter", *path.with_suffix("").parts))
    return name.removesuffix(".__init__")


def test_no_modules_import_each_other_in_a_circle():
    modules = {module_name(path): path for path in MODULES}
    graph = {}
    for module, path in modules.items():
        names = imported_names((PACKAGE / path).read_text(), path)
        graph[module] = {name if name in modules else name.rpartition(".")[0]
                         for name in names} & set(modules) - {module}
    assert sum(map(len, graph.values())) > 500
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_imports_are_allowed(path):
    assert violations((PACKAGE / path).read_text(), path) == [], f"in '{home_of(path)}'"


@pytest.mark.parametrize("path, line", [
    ("types.py", "from stack_counter.geometry import pose"),
    ("geometry/poses.py", "from stack_counter.fusion.region import Region"),
    ("fusion/tsdf.py", "import rclpy"),
    ("fusion/tsdf.py", "from stack_counter.container import rim"),
    ("fusion/tsdf.py", "import torch"),
    ("fusion/tsdf.py", "import open3d as o3d"),
    ("container/rim.py", "from stack_counter.lean_open3d import o3d"),
    ("reconstruction/heap.py", "def f():\n    from sensor_msgs.msg import Image"),
    ("pipeline.py", "import mcap.reader"),
    ("pipeline.py", "from stack_counter.bag import reader"),
    ("pipeline.py", "from . import nodes"),
    ("segmentation/labels.py", "from ..sim import physics"),
    ("segmentation/labels.py", "import rosbags"),
    ("occupancy/network.py", "import importlib\nimportlib.import_module('sapien')"),
    ("bag/reader.py", "import rclpy.node"),
    ("bag/reader.py", "from stack_counter.ros.player import play"),
    ("ros/player.py", "from stack_counter.nodes import collector"),
    ("nodes/collector.py", "import mcap"),
    ("nodes/collector.py", "from stack_counter.bag import reader"),
    ("nodes/collector.py", "from stack_counter.bag.scan_file import Recording"),
    ("nodes/counter.py", "from stack_counter.sim import record"),
    ("sim/report.py", "import stack_counter.train.gamma"),
    ("sim/report.py", "from stack_counter import eval"),
    ("train/gamma.py", "from stack_counter.sim.physics.drop import simulate_pile"),
    ("train/gamma.py", "from stack_counter.sim import dataset"),
    ("train/gamma.py", "from stack_counter import teaching"),
    ("eval/count.py", "from stack_counter.cli import main"),
    ("eval/count.py", "from tqdm import tqdm"),
])
def test_a_violation_is_noticed(path, line):
    assert violations(line, Path(path))


@pytest.mark.parametrize("path, line", [
    ("fusion/tsdf.py", "from stack_counter.lean_open3d import o3d"),
    ("bag/reader.py", "import mcap.reader\nfrom stack_counter.errors import BagError"),
    ("ros/player.py", "import rclpy\nfrom std_srvs.srv import Trigger\nfrom .qos import RELIABLE"),
    ("nodes/counter.py", "import rclpy\nfrom stack_counter.ros import qos"),
    ("nodes/scan_recording.py", "from stack_counter.bag.recorder import Recorder"),
    ("sim/report.py", "import sapien\nfrom stack_counter.sim.shapes import make_shape"),
    ("train/gamma.py", "from stack_counter.sim import record"),
    ("cli/main.py", "from stack_counter.nodes import collector\nimport stack_counter.sim.report"),
])
def test_what_is_allowed_passes(path, line):
    assert violations(line, Path(path)) == []


def test_coverage_runs_the_tests_of_every_package_that_it_measures():
    settings = configparser.ConfigParser()
    settings.read(PACKAGE.parent / "setup.cfg")
    omitted = re.findall(r"stack_counter/(\w+)/", settings["coverage:run"]["omit"])
    makefile = (PACKAGE.parent / "Makefile").read_text().replace("\\\n", " ")
    run = set(re.search(r"^CORE := .*addprefix test/,(.*)\)", makefile, re.MULTILINE)[1].split())
    measured = {path.name for path in PACKAGE.iterdir() if path.is_dir()} - {*omitted}
    tested = {path.name for path in (PACKAGE.parent / "test").iterdir() if path.is_dir()}
    assert {"geometry", "container"} <= measured and measured & tested <= run <= tested


def test_the_core_loads_no_ros_bags_or_engine():
    """All packages down to the pipeline, imported in a fresh interpreter, pull in none of them."""
    core = {*GROUND, *list(LAYERS)[:list(LAYERS).index("pipeline") + 1]}
    names = ["stack_counter." + ".".join(path.with_suffix("").parts).removesuffix(".__init__")
             for path in MODULES if home_of(path) in core]
    assert {name.split(".")[0] for name in loaded(*names)} & set(ROS_AND_BAGS) == set()


def test_the_recorder_brings_no_ros_and_no_player_into_the_nodes():
    got = loaded("stack_counter.bag.recorder")
    assert "rclpy" not in got
    assert {name for name in got if name.startswith("stack_counter.bag.")} == {
        f"stack_counter.bag.{module}"
        for module in ("message_definitions", "recorder", "scan_file")}


@pytest.mark.parametrize("node, slow", [
    ("collector", {"scipy", "open3d", "torch"}),
    ("reconstructor", {"dash", "torch"}),
    ("counter", {"scipy", "open3d", "torch"})])
def test_a_node_loads_nothing_slow_that_it_does_not_need(node, slow):
    assert loaded(f"stack_counter.nodes.{node}") & slow == set()


def loaded(*names):
    """All modules that a fresh interpreter has loaded after importing these."""
    code = "import importlib, json, sys\n" \
           "for name in sys.argv[1:]: importlib.import_module(name)\n" \
           "print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code, *names], capture_output=True, text=True,
                          cwd=PACKAGE.parent)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout))
