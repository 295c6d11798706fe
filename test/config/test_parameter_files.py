# SPDX-License-Identifier: Apache-2.0
"""Parameter files in every way that ROS 2 names nodes, and as `ros2 param dump` writes them."""

import pytest
import yaml

from stack_counter.config import Config, load_config, read_parameters, to_ros_parameters
from stack_counter.config.named_region import NamedRegion
from stack_counter.config.parameter_files import write_parameter_file
from stack_counter.errors import ConfigError


def written(tmp_path, text):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", [
    "/stack_counter/collector", "stack_counter/collector", "collector", "/collector", "/**",
    "/*/collector", "/stack_counter/*", "/**/collector", "/*/*", "/stack_counter/**"])
def test_nodes_may_be_named_in_every_way_of_ros(tmp_path, name):
    path = written(tmp_path, f"{name}:\n  ros__parameters:\n    min_motion_m: 0.5\n")
    assert load_config(path).collector.min_motion_m == 0.5


@pytest.mark.parametrize("text", [
    "/stack_counter:\n  collector:\n    ros__parameters: {mode: cycle}\n"
    "  counter:\n    ros__parameters: {part: nut}\n",
    "stack_counter: {collector: {ros__parameters: {mode: cycle}},"
    " counter: {ros__parameters: {part: nut}}}"])
def test_nodes_may_stand_within_their_namespace(tmp_path, text):
    config = load_config(written(tmp_path, text))
    assert (config.collector.mode, config.counter.part) == ("cycle", "nut")


def test_a_wildcard_gives_each_node_what_it_has_and_later_lines_stand_on_top(tmp_path):
    config = load_config(written(tmp_path, """
/**:
  ros__parameters: {part: nut, live: true, robot_description: <robot/>, use_sim_time: true}
/stack_counter/counter:
  ros__parameters: {part: bolt}
"""))
    assert (config.collector.part, config.counter.part) == ("nut", "bolt")
    assert config.reconstructor.live


def test_what_param_dump_writes_is_read_back(tmp_path):
    region = NamedRegion("left", (0.1, 0.2, 0.3), (1.0, 1.0, 1.0))
    dumped = yaml.safe_load(to_ros_parameters(Config()))
    dumped["/stack_counter/reconstructor"]["ros__parameters"].update(
        autostart=True, use_sim_time=False, start_type_description_service=True,
        qos_overrides={"/clock": {"subscription": {"depth": 1}}, "/parameter_events": {
            "publisher": {"depth": 1000, "durability": "volatile", "history": "keep_last"}}},
        regions={"left": {"center_m": list(region.center_m), "size_m": list(region.size_m)}})
    path = written(tmp_path, yaml.dump(dumped, default_flow_style=False))
    assert load_config(path).reconstructor.regions == (region,)
    # What ROS itself gives a node is handed on.
    again = written(tmp_path, write_parameter_file(read_parameters(path)))
    assert "/clock" in yaml.safe_load(again.read_text())["/stack_counter/reconstructor"][
        "ros__parameters"]["qos_overrides"]
    assert load_config(again).reconstructor.regions == (region,)


def test_names_with_dots_and_numbers_without_a_point_are_read_as_ros_reads_them(tmp_path):
    config = load_config(written(tmp_path, """
reconstructor:
  ros__parameters:
    voxel_size: 2e-3
    regions.left.center_m: [1e-1, 0.2, 0.3]
    regions.left.size_m: [1.0, 1.0, 1.0]
"""))
    assert config.reconstructor.voxel_size == 0.002
    assert config.reconstructor.regions[0].center_m == (0.1, 0.2, 0.3)


@pytest.mark.parametrize("text, said", [
    ("collector: {ros__parameters: {color_topics: /a}}",
     "unknown setting 'color_topics' of collector; expected 'color_topic'"),
    ("/**: {ros__parameters: {voxelsize: 0.1}}",
     "unknown setting 'voxelsize' of collector, reconstructor, counter; expected 'voxel_size'"),
    ("collector: {ros__parameters: {live: true}}",
     "unknown setting 'live' of collector; expected it under /stack_counter/reconstructor"),
    ("counter: {ros__parameters: {qwerty: 1}}", "expected one of .*'confidence'"),
    ("/stack_counter/colector: {ros__parameters: {}}",
     "names node '/stack_counter/colector'; expected /stack_counter/collector,"),
    ("/cell1/collector: {ros__parameters: {}}", "names node '/cell1/collector'"),
    ("/camera/camera: {ros__parameters: {a: 1}}", "names node '/camera/camera'; expected"),
    ("/stack_counter: {collector: {mode: cycle}}", "'/stack_counter/collector' lacks ros__par"),
    ("/stack_counter/collector: {mode: cycle}", "'/stack_counter/collector' lacks ros__par"),
    ("/**: {ros__parameters: {mode: cycle}}\n/**: {ros__parameters: {part: nut}}",
     "'/\\*\\*' stands twice in one mapping; expected it once"),
    ("collector: {ros__parameters: 3}", "'collector' has ros__parameters 3"),
    ("collector: {ros__parameters: {mode: often}}", "mode is 'often'")])
def test_faults_are_named_with_what_was_meant(tmp_path, text, said):
    with pytest.raises(ConfigError, match=said):
        load_config(written(tmp_path, text))


def test_parameters_of_other_nodes_may_stand_beside_ours(tmp_path):
    config = load_config(written(tmp_path, "/camera/camera: {ros__parameters: {a: 1}}\n"
                                           "/**/counter: {ros__parameters: {part: nut}}"))
    assert config.counter.part == "nut"
