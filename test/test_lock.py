# SPDX-License-Identifier: Apache-2.0
"""requirements.lock holds what setup.py asks for, each package by version and hash."""

import re
import runpy
from pathlib import Path

import pytest
from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.lock"
# A line of the lock, and the hashes in the lines behind it.
PIN = re.compile(r"^(?P<name>[\w.-]+)==(?P<version>[\w.]+)(?: ; (?P<marker>.*?))? \\\n"
                 r"(?P<hashes>(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", re.MULTILINE)
PYTHONS = ("3.11", "3.12", "3.13")


def environment(python):
    return {"python_version": python, "python_full_version": f"{python}.7",
            "sys_platform": "linux", "platform_machine": "x86_64", "platform_system": "Linux",
            "implementation_name": "cpython", "platform_python_implementation": "CPython",
            "os_name": "posix", "extra": ""}


def pinned(python):
    """Versions of the packages that the lock has for a Python on Linux, by name."""
    pins = {}
    for pin in PIN.finditer(LOCK.read_text()):
        if not pin["marker"] or Marker(pin["marker"]).evaluate(environment(python)):
            assert pin["name"] not in pins, f"{pin['name']} is pinned twice"
            pins[canonicalize_name(pin["name"])] = Version(pin["version"])
    return pins


@pytest.mark.parametrize("python", PYTHONS)
def test_the_lock_satisfies_every_bound(python):
    lists = runpy.run_path(str(ROOT / "setup.py"))
    lines = lists["REQUIRES"] + [line for extra, lines in lists["EXTRAS"].items()
                                 if extra != "sourced" for line in lines]
    pins, wrong = pinned(python), []
    for requirement in map(Requirement, lines):
        if requirement.marker and not requirement.marker.evaluate(environment(python)):
            continue
        version = pins.get(canonicalize_name(requirement.name))
        if version is None or not requirement.specifier.contains(version):
            wrong.append(f"{requirement}: {version}")
    assert not wrong, "run make lock"


def test_every_line_is_a_pin_with_its_hashes_and_names_no_registry():
    text = LOCK.read_text()
    rest = PIN.sub("", text)
    assert all(line.startswith("#") for line in rest.splitlines())
    assert "://" not in text and "--index" not in text and "--find-links" not in text
