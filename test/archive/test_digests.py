# SPDX-License-Identifier: Apache-2.0
"""Digests change with what a count depends on, and with nothing else."""

import os
import shutil
from dataclasses import replace

import pytest

from stack_counter.archive.digests import (
    bag_digest,
    bag_state,
    part_digest,
    result_key,
    settings_digest,
    with_absolute_paths,
)
from stack_counter.config import CollectorConfig, Config, CounterConfig, ReconstructorConfig
from stack_counter.parts.catalogue import Part


def write(path, content=b"x"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def test_a_bag_is_its_content_wherever_it_lies(tmp_path):
    a, b = write(tmp_path / "a.mcap", b"1"), write(tmp_path / "b.mcap", b"2")
    copy = write(tmp_path / "elsewhere/other.mcap", b"1")
    assert bag_digest(a) == bag_digest(copy) != bag_digest(b)


def test_the_state_of_a_bag_says_whether_it_was_written_to(tmp_path):
    a = write(tmp_path / "a.mcap", b"1")
    before = bag_state(a)
    assert bag_state(a) == before
    os.utime(a, ns=(0, 1))
    assert bag_state(a) != before
    shutil.copy2(a, tmp_path / "b.mcap")
    assert bag_state(tmp_path / "b.mcap") == bag_state(a)


@pytest.mark.parametrize("changed", [
    Config(counter=CounterConfig(confidence=0.8)), Config(counter=CounterConfig(part="bolt")),
    Config(reconstructor=ReconstructorConfig(voxel_size=0.001)),
    Config(collector=CollectorConfig(depth_scale=0.001))])
def test_settings_that_matter_give_another_digest(changed):
    assert settings_digest(changed) != settings_digest(Config())


@pytest.mark.parametrize("same", [
    Config(counter=CounterConfig(result_log="x.csv", part_catalogue="parts.yaml")),
    Config(collector=CollectorConfig(record_folder="/cell")),
    Config(reconstructor=ReconstructorConfig(report_folder="/cell"))])
def test_where_things_are_written_does_not_matter(same):
    assert settings_digest(same) == settings_digest(Config())


def test_of_a_file_that_settings_name_the_content_matters(tmp_path):
    def digest(path):
        return settings_digest(Config(counter=CounterConfig(weights=str(path))))

    a, b = write(tmp_path / "a", b"1"), write(tmp_path / "b", b"1")
    same = digest(a)
    assert digest(b) == same
    write(b, b"2")
    assert digest(b) != same


def test_paths_that_settings_name_become_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a", b"1")
    config = Config(counter=CounterConfig(weights="a", part_catalogue="a", part="a"),
                    reconstructor=ReconstructorConfig(prompts="{parts: a}"))
    made = with_absolute_paths(config)
    assert made.counter.weights == made.counter.part_catalogue == str(tmp_path / "a")
    assert (made.counter.part, made.reconstructor) == ("a", config.reconstructor)
    assert settings_digest(made) == settings_digest(config)


def test_prompts_as_text_are_no_path():
    prompts = "{parts: {points: [[" + "3, " * 400 + "2]]}}"  # longer than a path may be
    config = Config(reconstructor=ReconstructorConfig(prompts=prompts))
    assert settings_digest(config) and with_absolute_paths(config) == config


def test_what_is_known_of_a_part_matters_and_not_its_name(tmp_path):
    part = Part(1e-6, "a", gamma_prior=write(tmp_path / "prior", b"1"), note="x")
    same = part_digest(part)
    assert part_digest(replace(part, name="b", note="y")) == same
    assert part_digest(replace(part, unit_volume=2e-6)) != same
    write(tmp_path / "prior", b"2")
    assert part_digest(part) != same


def test_a_key_is_of_all_four():
    keys = {result_key(*words) for words in ("abcd", "xbcd", "axcd", "abxd", "abcx")}
    assert len(keys) == 5
