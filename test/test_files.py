# SPDX-License-Identifier: Apache-2.0
"""Weights are read by one function, which says what is wrong with a file; writing is atomic."""

import pickle

import numpy as np
import pytest
from safetensors.numpy import save_file

from stack_counter.errors import ConfigError, WeightsError
from stack_counter.files import config_path, read_weights, shipped_weights, write_atomically

FORMAT = "stack_counter test 1"


def saved(path, format_name=FORMAT, **tensors):
    save_file(tensors or {"a": np.arange(3.0)}, path, metadata={"format": format_name, "by": "x"})
    return path


def test_tensors_and_metadata_come_back(tmp_path):
    half = np.linspace(0, 1, 6).astype(np.float16).reshape(2, 3)
    read = read_weights(saved(tmp_path / "w.safetensors", half=half, n=np.array([7])), FORMAT)
    assert read.metadata == {"format": FORMAT, "by": "x"}
    assert read.tensors["half"].dtype == np.float16
    assert np.array_equal(read.tensors["half"], half) and read.tensors["n"].tolist() == [7]


def test_what_is_no_such_file_is_refused_with_its_path(tmp_path):
    path = tmp_path / "w.safetensors"
    with pytest.raises(WeightsError, match=f"no weights file {path}; expected a safetensors"):
        read_weights(path, FORMAT)
    path.write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises(WeightsError, match=f"{path} is not a whole safetensors file"):
        read_weights(path, FORMAT)
    path.write_bytes(saved(path).read_bytes()[:-8])
    with pytest.raises(WeightsError, match="not a whole safetensors file"):
        read_weights(path, FORMAT)
    with pytest.raises(WeightsError, match=f"is 'other 2'; expected '{FORMAT}'"):
        read_weights(saved(path, "other 2"), FORMAT)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(tmp_path, bad):
    path = saved(tmp_path / "w.safetensors", fine=np.ones(2), broken=np.array([1.0, bad]))
    with pytest.raises(WeightsError, match="broken holds NaN or infinite"):
        read_weights(path, FORMAT)


@pytest.mark.parametrize("name, file_format", [
    ("baselines.safetensors", "stack_counter baselines 1"),
    ("direct.safetensors", "stack_counter gamma 1"),
    ("gamma.safetensors", "stack_counter gamma 1"), ("wall.safetensors", "stack_counter wall 1")])
def test_shipped_weights_can_be_read(name, file_format):
    assert read_weights(shipped_weights(name), file_format).tensors


def test_a_file_is_replaced_whole_and_nothing_is_left_beside_it(tmp_path):
    path = tmp_path / "parts.yaml"
    for text in ("old\n", "new\n"):
        write_atomically(path, text)
        assert path.read_text() == text
    assert [p.name for p in tmp_path.iterdir()] == ["parts.yaml"]


def test_a_configuration_file_that_is_nowhere_is_an_error():
    assert config_path("parts.yaml").is_file()
    with pytest.raises(ConfigError, match="no nothing.yaml in "):
        config_path("nothing.yaml")
