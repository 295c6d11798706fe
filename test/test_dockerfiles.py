# SPDX-License-Identifier: Apache-2.0
"""Both Dockerfiles start what the command line has, as no root, with what set-up asks for."""

import json
import re
import shlex
from pathlib import Path

import pytest

from stack_counter.cli.main import _make_parser
from stack_counter.cli.run import parse_parameters

ROOT = Path(__file__).parents[1]
FILES = {"debian": "debian:trixie-slim", "jazzy": "ros:jazzy-ros-core"}
ALLOWED = re.findall(r"^!(.+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE)


def instructions(name):
    """Pairs of an instruction and what it is given, comments and line breaks taken out."""
    text = (ROOT / "docker" / f"Dockerfile.{name}").read_text()
    text = re.sub(r"\\\n\s*", "", re.sub(r"^\s*#.*\n", "", text, flags=re.MULTILINE))
    return [tuple(line.split(maxsplit=1)) for line in text.splitlines() if line.strip()]


def last_stage(name):
    """What each instruction of the last stage is given; of several, the last one's."""
    found = instructions(name)
    begin = max(i for i, (kind, _) in enumerate(found) if kind == "FROM")
    return dict(found[begin:])


def command(given):
    """The list of words in an instruction's square brackets."""
    return json.loads(given[given.index("["):])


@pytest.mark.parametrize("name, base", FILES.items())
def test_stages_begin_with_the_image_and_the_last_has_no_compiler(name, base):
    froms = [given for kind, given in instructions(name) if kind == "FROM"]
    assert froms == [f"{base} AS base", "base AS build", "base"]
    (runs, builds) = [given for kind, given in instructions(name)
                      if kind == "RUN" and "apt-get install" in given]
    assert not {"g++", "make", "python3-dev"} & set(runs.split())
    # What scripts/setup.sh looks for: libraries are kept, programs are left behind.
    asked = set(re.findall(r'"[\w.+-]+", "(lib[\w.-]+|g\+\+|make)"',
                           (ROOT / "scripts" / "setup.sh").read_text()))
    assert {"libgl1", "g++"} < asked
    assert asked <= {*runs.split(), *builds.split()}
    assert {package for package in asked if package.startswith("lib")} <= set(runs.split())


@pytest.mark.parametrize("name", FILES)
def test_it_is_started_and_checked_by_commands_that_exist_and_not_as_root(name):
    stage = last_stage(name)
    assert stage["USER"] == "counter"
    assert any(kind == "RUN" and re.match(r"useradd .* counter ", given)
               for kind, given in instructions(name))
    program = command(stage["ENTRYPOINT"])
    assert program == ["stack-counter"]
    started = _make_parser().parse_args(command(stage["CMD"]))
    folder = parse_parameters(started.parameters)["record_folder"]
    assert any(folder.startswith(volume) for volume in command(stage["VOLUME"]))
    health = command(stage["HEALTHCHECK"])
    assert health[:1] == program and _make_parser().parse_args(health[1:]).nodes


@pytest.mark.parametrize("name", FILES)
def test_what_is_copied_exists_and_suffices(name):
    copied = [shlex.split(given) for kind, given in instructions(name) if kind == "COPY"]
    assert [words for words in copied if not words[0].startswith("--from")] == [[".", "."]]
    assert all((ROOT / path).exists() for path in ALLOWED)
    assert not any((ROOT / path).match("data") for path in ALLOWED)
    # What `make setup-cell` reads, and the bag that the last stage counts.
    assert {"Makefile", "scripts/setup.sh", "setup.py", "setup.cfg", "package.xml", "resource",
            "config", "launch", "msg_defs", "stack_counter"} < set(ALLOWED)
    counted = re.findall(r"replay (\S+)", " ".join(given for _, given in instructions(name)))
    assert counted and set(counted) <= set(ALLOWED)


def test_both_are_run_alike():
    kinds = ("USER", "VOLUME", "HEALTHCHECK", "ENTRYPOINT", "CMD", "ENV", "WORKDIR")
    debian, jazzy = (last_stage(name) for name in FILES)
    assert [debian[kind] for kind in kinds] == [jazzy[kind] for kind in kinds]
