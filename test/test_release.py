# SPDX-License-Identifier: Apache-2.0
"""What the build farm asks of the message package, and what users of the packages' types do."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from catkin_pkg.package import parse_package
from catkin_pkg.package_version import get_forthcoming_label
from setuptools import find_packages

import stack_counter

ROOT = Path(__file__).parents[1]


def test_the_message_package_has_what_a_release_needs():
    package = ElementTree.parse(ROOT / "msg_defs" / "package.xml").getroot()
    assert package.findtext("author") and package.findtext("license") == "Apache-2.0"
    named = ROOT / "msg_defs" / package.find("license").attrib["file"]
    assert named.read_bytes() == (ROOT / "LICENSE").read_bytes()
    versions = {package.findtext("version"),
                ElementTree.parse(ROOT / "package.xml").getroot().findtext("version")}
    assert versions == {stack_counter.__version__}


@pytest.mark.parametrize("folder", ["", "msg_defs"])
def test_the_tools_of_a_release_take_package_and_changelog(folder):
    warnings = []
    package = parse_package(ROOT / folder, warnings=warnings)
    package.validate(warnings=warnings)
    assert warnings == []
    assert all("example" not in person.email for person in package.maintainers)
    changelog = (ROOT / folder / "CHANGELOG.rst").read_text()
    assert f"Changelog for package {package.name}\n" in changelog
    assert get_forthcoming_label(changelog) == "Forthcoming"


def test_every_folder_with_modules_is_installed():
    package = Path(stack_counter.__file__).parent
    folders = {path.parent.relative_to(package.parent) for path in package.rglob("*.py")}
    assert {str(folder).replace("/", ".") for folder in folders} <= set(
        find_packages(str(package.parent), include=["stack_counter", "stack_counter.*"]))


def test_every_file_of_the_report_page_is_installed():
    package = Path(stack_counter.__file__).parent
    text = (ROOT / "setup.py").read_text()
    patterns = re.findall(r'"(display/page/[^"]+)"', text)
    installed = {path for pattern in patterns for path in package.glob(pattern)}
    wanted = {path for path in (package / "display" / "page").rglob("*")
              if path.is_file() and path.suffix not in (".py", ".pyc")}
    assert wanted == installed and len(wanted) == 7


def test_the_package_says_that_it_is_typed():
    assert (Path(stack_counter.__file__).parent / "py.typed").is_file()
