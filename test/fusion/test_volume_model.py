# SPDX-License-Identifier: Apache-2.0
"""The volume model's file: read whole or refused with its reason."""

import json
from dataclasses import asdict

import pytest

from stack_counter.errors import WeightsError
from stack_counter.files import shipped_weights
from stack_counter.fusion.volume_model import FORMAT, read_volume_model, volume_model

SHIPPED = shipped_weights("volume.json")


def test_the_shipped_model_is_read_once():
    assert volume_model() is volume_model() == read_volume_model(SHIPPED)


def test_the_values_are_those_that_counts_rest_on():
    assert asdict(volume_model()) == {
        "hidden_share": 0.65, "hidden_share_one_side": 0.85, "hidden_share_one_side_heap": 1.0,
        "worn_height_m": 0.0004, "level_std_m": 0.0005, "level_std_per_noise": 0.25,
        "wall_std_m": 0.0003, "filled_in_std": 0.1, "floor_std_per_wall": 0.1, "volume_std": 0.01,
        "heap_std": 0.04, "lost_rim_width_m": 0.0012, "lost_rim_width_per_noise": 0.95,
        "lost_rim_width_std": 0.4, "stereo_std": 0.05}


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(WeightsError, match="no volume model .*nowhere.json"):
        read_volume_model(tmp_path / "nowhere.json")


@pytest.mark.parametrize("text, message", [
    ("{", "is no JSON"), ("[]", "is 'list'; expected 'stack_counter volume model 1'"),
    ('{"format": "other"}', "is 'other'"),
    (json.dumps({"format": FORMAT, "numbers": []}), "hidden_share is None"),
    (json.dumps({"format": FORMAT, "numbers": {"hidden_share": 0.65}}), "hidden_share is None"),
])
def test_a_file_of_another_form_is_refused(tmp_path, text, message):
    path = tmp_path / "volume.json"
    path.write_text(text)
    with pytest.raises(WeightsError, match=message):
        read_volume_model(path)


@pytest.mark.parametrize("value", [None, "0.4", -0.1, float("nan"), float("inf"), True])
def test_a_value_that_is_no_size_is_refused(tmp_path, value):
    content = json.loads(SHIPPED.read_text())
    content["numbers"]["heap_std"]["value"] = value
    path = tmp_path / "volume.json"
    path.write_text(json.dumps(content))
    with pytest.raises(WeightsError, match=f"heap_std is {value}; expected a finite number"):
        read_volume_model(path)
