# SPDX-License-Identifier: Apache-2.0
"""The settings file documents every parameter and its default."""

import dataclasses
from pathlib import Path

import pytest

from stack_counter.config import (
    Config,
    ReconstructorConfig,
    build_section,
    load_config,
    to_ros_parameters,
)
from stack_counter.errors import ConfigError

SHIPPED = Path(__file__).parents[2] / "config" / "stack_counter.yaml"


def test_shipped_file_holds_every_default_and_its_description():
    assert load_config(SHIPPED) == Config()
    lines = SHIPPED.read_text().splitlines()
    for section in dataclasses.fields(Config):
        for setting in dataclasses.fields(section.default):
            places = [i for i, line in enumerate(lines)  # the example of some is a comment
                      if line.strip("# ").startswith(f"{setting.name}:")]
            assert places, setting.name
            assert any(setting.metadata["doc"] in lines[i - 1] for i in places), setting.name


def test_round_trip_through_a_parameter_file(tmp_path):
    config = Config(reconstructor=ReconstructorConfig(voxel_size=0.003, live=True))
    (tmp_path / "p.yaml").write_text(to_ros_parameters(config))
    assert load_config(tmp_path / "p.yaml") == config


@pytest.mark.parametrize("values, said", [
    ({"voxel_size": -1}, "voxel_size is -1.0; expected 0.0 to 0.1"),
    ({"voxel_size": float("nan")}, "voxel_size is nan"),
    ({"min_views": 2.5}, "min_views is 2.5; expected int"),
    ({"live": 1}, "live is 1; expected bool"),
    ({"container_inner_size_m": [1, 2]}, "has 2 numbers; expected 3"),
    ({"container_kind": "bag"}, "container_kind is 'bag'; expected one of")])
def test_bad_values_are_named(values, said):
    with pytest.raises(ConfigError, match=said.split("(")[0]):
        build_section(ReconstructorConfig, values)
