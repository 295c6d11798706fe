# SPDX-License-Identifier: Apache-2.0
"""Weights are read by one function; files that users edit keep their comments."""

import pickle

import numpy as np
import pytest

from stack_counter.errors import ConfigError, WeightsError
from stack_counter.files import (
    config_path,
    edit_yaml_entry,
    parse_yaml,
    read_weights,
    shipped_weights,
    write_atomically,
    write_weights,
)

FORMAT = "stack_counter test 1"


def saved(path, format_name=FORMAT, **tensors):
    write_weights(path, format_name, tensors or {"a": np.arange(3.0)}, {"by": "x"})
    return path


def test_tensors_and_metadata_come_back(tmp_path):
    half = np.linspace(0, 1, 6).astype(np.float16).reshape(2, 3)
    read = read_weights(saved(tmp_path / "w.safetensors", half=half, n=np.array([7])), FORMAT)
    assert read.metadata == {"format": FORMAT, "by": "x"}
    assert read.tensors["half"].dtype == np.float16
    assert np.array_equal(read.tensors["half"], half) and read.tensors["n"].tolist() == [7]


def test_weights_are_as_readable_as_any_file_and_turned_arrays_are_written_as_they_are(tmp_path):
    turned = np.arange(6.0).reshape(2, 3).T
    path = saved(tmp_path / "w.safetensors", turned=turned)
    (tmp_path / "other").write_text("")
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode
    assert np.array_equal(read_weights(path, FORMAT).tensors["turned"], turned)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other", "w.safetensors"]


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


# --- YAML that users edit ------------------------------------------------------------------------

@pytest.mark.parametrize("text", [
    "a:\n", "# one\na: {}\n", "a:\n  # below\n", "a: {c: {x: 1}} # e\n", "a:\n  c: {x: 1}",
    "a:\n  c:\n    x: 1\n  # end\nb: 1\n"])
def test_an_entry_is_added_changed_and_removed(text):
    before = parse_yaml(text)
    values = {"x": 0.5, "text": "yes: #", "list": [1, 2.5], "maps": [{"k": True, "l": [1.0]}]}
    added = edit_yaml_entry(text, "a", "new", values)
    assert parse_yaml(added) == {**before, "a": {**(before["a"] or {}), "new": values}}
    values["x"] = 1e-6
    changed = edit_yaml_entry(added, "a", "new", values)
    assert parse_yaml(changed)["a"]["new"] == values
    removed = edit_yaml_entry(changed, "a", "new", None)
    assert (parse_yaml(removed)["a"] or {}) == (before["a"] or {})
    for comment in ("# one", "# below", "# e", "# end"):
        assert (comment in text) == (comment in removed)


def test_lines_of_other_entries_stay_as_they_are():
    text = "a:\n    one:   {x:  1}   # odd\n    two:\n        x: 0x10\n    'three': {x: .5}\n"
    changed = edit_yaml_entry(text, "a", "two", {"x": 16, "y": 2}, {"y": "why"})
    lines = changed.splitlines()
    assert [*lines[:4], *lines[5:]] == text.splitlines()
    assert lines[4].split() == ["y:", "2", "#", "why"]


def test_an_entry_that_refers_to_another_is_written_out():
    text = "a:\n  one: &one {x: 1}\n  two: *one\n"
    assert parse_yaml(edit_yaml_entry(text, "a", "two", {"x": 2})) == {
        "a": {"one": {"x": 1}, "two": {"x": 2}}}


@pytest.mark.parametrize("text, what", [
    ("a: [", "line 1"), ("a: {b: 1, b: 2}", "two entries 'b' .*line 1"),
    ("a:\n  1: x\n  '1': y", "two entries '1' .*line 3"), ("a: !!python/object:os.x {}", "tag")])
def test_what_is_no_yaml_or_names_a_key_twice_is_one_line(text, what):
    with pytest.raises(ValueError, match=what) as caught:
        parse_yaml(text)
    assert "\n" not in str(caught.value)
