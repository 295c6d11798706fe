# SPDX-License-Identifier: Apache-2.0
"""Bags are found whatever shape they have; what lies in one is no other."""

import pytest

from stack_counter.archive.bag_search import find_bags
from stack_counter.errors import ConfigError


def make(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def found(folder, path=None):
    return [str(bag.relative_to(folder)) for bag in find_bags(path or folder)]


def test_bags_of_every_shape_are_found_at_any_depth(tmp_path):
    make(tmp_path, "a/metadata.yaml", "a/a_0.mcap", "a/a_1.mcap",  # a rosbag2 folder
         "b/deep/one.mcap", "b/deep/two.db3.zstd",  # files
         "split/scan_0.mcap", "split/scan_1.mcap",  # one bag whose recorder was killed
         "scans/scan_20261127-080000-000_x.mcap", "scans/scan_20261127-090000-000_x.mcap",
         "scans/scan_20261127-100000-000_x.mcap.part", "notes.txt", "old.bag")
    assert found(tmp_path) == [
        "a", "b/deep/one.mcap", "b/deep/two.db3.zstd", "old.bag",
        "scans/scan_20261127-080000-000_x.mcap", "scans/scan_20261127-090000-000_x.mcap", "split"]


def test_a_bag_itself_is_one(tmp_path):
    make(tmp_path, "a/metadata.yaml", "a/a.mcap", "b.mcap")
    assert found(tmp_path, tmp_path / "a") == ["a"]
    assert found(tmp_path, tmp_path / "b.mcap") == ["b.mcap"]


def test_a_list_names_bags_from_its_own_folder_on_each_once(tmp_path):
    (tmp_path / "list.txt").write_text("# of Monday\nb.mcap\n\n a \nb.mcap\n/cell/c\n")
    assert list(map(str, find_bags(tmp_path / "list.txt"))) == [
        f"{tmp_path}/b.mcap", f"{tmp_path}/a", "/cell/c"]


@pytest.mark.parametrize("content, error, said", [
    (None, FileNotFoundError, "no archive .*/x; expected a folder with bags, or a list"),
    (b"\xff\xfe\x00", ConfigError, "x is no text; expected a folder with bags, or a list"),
    (b"# nothing\n", ConfigError, "no bag in .*/x; expected a rosbag2 folder or"),
])
def test_what_names_no_bag_is_refused(tmp_path, content, error, said):
    if content is not None:
        (tmp_path / "x").write_bytes(content)
    with pytest.raises(error, match=said):
        find_bags(tmp_path / "x")
