# SPDX-License-Identifier: Apache-2.0
"""The launch files, with a stand-in for launch that keeps what is declared: it is not on PyPI."""

import dataclasses
import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from stack_counter.config import Config

ROOT = Path(__file__).parents[1]


class Declared(SimpleNamespace):
    """An action with its arguments; of those by position, in `args`."""

    def __init__(self, kind, *args, **fields):
        super().__init__(kind=kind, args=args, **fields)

    def perform(self, context):
        return context[self.args[0]]


@pytest.fixture
def load(monkeypatch):
    """Loads a launch file; returns its module."""
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "OpaqueFunction", "SetEnvironmentVariable",
                           "ExecuteProcess", "IncludeLaunchDescription", "TimerAction"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
        "launch_ros": [], "launch_ros.actions": ["Node"],
        "ament_index_python": [], "ament_index_python.packages": []}
    for module, kinds in names.items():
        made = ModuleType(module)
        for kind in kinds:
            setattr(made, kind, lambda *a, kind=kind, **f: Declared(kind, *a, **f))
        made.get_package_share_directory = lambda package: str(ROOT)
        monkeypatch.setitem(sys.modules, module, made)

    def load(name):
        spec = importlib.util.spec_from_file_location(name, ROOT / "launch" / f"{name}.launch.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module
    return load


def declared(description):
    return {a.args[0]: a for a in description.args[0] if a.kind == "DeclareLaunchArgument"}


def nodes(module, **given):
    description = module.generate_launch_description()
    context = {name: getattr(a, "default_value", "") for name, a in
               declared(description).items()} | given
    make, = (a.function for a in description.args[0] if a.kind == "OpaqueFunction")
    return {node.executable: node for node in make(context)}


def test_three_processes_that_come_back(load):
    started = nodes(load("stack_counter"))
    assert set(started) == {"collector", "reconstructor", "counter"}
    assert all(n.package == "stack_counter" and n.respawn for n in started.values())
    for node in started.values():
        file, given = node.parameters
        assert Path(file) == ROOT / "config" / "stack_counter.yaml" and given == {}


def test_what_is_given_is_a_parameter_of_its_type_and_nothing_else_is(load):
    started = nodes(load("stack_counter"), part="nut", expected_count="180", prompts="p.yaml",
                    unit_volume_m3="2e-6", reliable="false", live="true", use_sim_time="true")
    assert started["collector"].parameters[1] == {"part": "nut", "unit_volume_m3": 2e-6,
                                                  "reliable": False, "use_sim_time": True}
    assert started["reconstructor"].parameters[1] == {
        "prompts": "p.yaml", "live": True, "use_sim_time": True}
    assert started["counter"].parameters[1] == {"part": "nut", "unit_volume_m3": 2e-6,
                                                "expected_count": 180, "use_sim_time": True}


def test_every_argument_is_described_and_is_a_setting(load):
    module = load("stack_counter")
    assert all(a.description for a in declared(module.generate_launch_description()).values())
    for key, (_, node_names, kind) in module.ARGUMENTS.items():
        for node in node_names if key not in ("use_sim_time", "autostart") else ():
            fields = {f.name: f for f in dataclasses.fields(getattr(Config(), node))}
            assert isinstance(fields[key].default, tuple if kind is list else kind), (
                    node, key)


def test_a_bag_is_played_by_its_own_clock(load):
    description = load("replay").generate_launch_description()
    assert all(a.description for a in declared(description).values())
    include, = (a for a in description.args[0] if a.kind == "IncludeLaunchDescription")
    assert dict(include.launch_arguments) == {"use_sim_time": "true"}
    timer, = (a for a in description.args[0] if a.kind == "TimerAction")
    assert timer.actions[0].cmd[:3] == ["ros2", "bag", "play"] and "--clock" in \
        timer.actions[0].cmd
