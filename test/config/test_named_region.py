# SPDX-License-Identifier: Apache-2.0
"""The setting `regions`: what is read, what is refused by name."""

import pytest

from stack_counter.config import (
    Config,
    ReconstructorConfig,
    build_section,
    load_config,
    to_ros_parameters,
)
from stack_counter.config.named_region import NamedRegion, nest, read_regions, write_regions
from stack_counter.errors import ConfigError

LEFT = NamedRegion("left", (-0.1, 0.0, 0.1), (0.2, 0.3, 0.2))
RIGHT = NamedRegion("Right_2", (0.1, 0.0, 0.1), (0.2, 0.3, 0.25))


def test_a_parameter_file_keeps_the_regions_and_their_order(tmp_path):
    config = Config(reconstructor=ReconstructorConfig(regions=(RIGHT, LEFT)))
    (tmp_path / "p.yaml").write_text(to_ros_parameters(config))
    assert load_config(tmp_path / "p.yaml") == config


def test_without_regions_no_parameter_file_names_them():
    assert "regions" not in to_ros_parameters(Config())  # rcl refuses an empty mapping


def test_ros_parameters_give_the_same_mapping():
    flat = {f"regions.{name}.{key}": value for name, box in write_regions([LEFT, RIGHT]).items()
            for key, value in box.items()}
    nested = nest({"live": True, **flat})
    assert nested["live"] and read_regions(nested["regions"]) == (LEFT, RIGHT)
    with pytest.raises(ConfigError, match="regions is 5 beside regions.a.size_m"):
        nest({"regions": 5, "regions.a.size_m": [1.0, 1.0, 1.0]})


@pytest.mark.parametrize("value, said", [
    ([1], r"regions is \[1\]; expected names"),
    ({"a-b": {}}, "a region is named 'a-b'; expected letters, digits and _"),
    ({True: {}}, "a region is named True"),
    ({"": {}}, "a region is named ''"),
    ({"a": [0, 0, 0]}, r"regions.a has \[0, 0, 0\]; expected center_m and size_m"),
    ({"a": {"center_m": [0, 0, 0]}}, r"regions.a has \['center_m'\]"),
    ({"a": {"center_m": [0, 0], "size_m": [1, 1, 1]}}, r"regions.a.center_m is \[0, 0\]"),
    ({"a": {"center_m": "000", "size_m": [1, 1, 1]}}, "regions.a.center_m is '000'"),
    ({"a": {"center_m": [0, 0, float("nan")], "size_m": [1, 1, 1]}}, "expected three numbers"),
    ({"a": {"center_m": [0, 0, 0], "size_m": [1, 0, 1]}}, "size_m is .* expected .* above 0")])
def test_what_is_no_region_is_named(value, said):
    with pytest.raises(ConfigError, match=said):
        build_section(ReconstructorConfig, {"regions": value})


@pytest.mark.parametrize("beside, said", [
    ({"roi_size_m": [0.2, 0.2, 0.2]}, r"roi_size_m is \[0.2, .* beside regions \['left'\]"),
    ({"container_pose": "given"}, "container_pose is 'given' beside regions")])
def test_what_says_one_place_does_not_stand_beside_regions(beside, said):
    with pytest.raises(ConfigError, match=said):
        build_section(ReconstructorConfig, {"regions": write_regions([LEFT]), **beside})


def test_a_region_has_all_other_settings():
    config = ReconstructorConfig(min_views=5, regions=(LEFT, RIGHT))
    assert config.of_region(RIGHT) == ReconstructorConfig(
        min_views=5, roi_center_m=RIGHT.center_m, roi_size_m=RIGHT.size_m)
