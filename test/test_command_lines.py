# SPDX-License-Identifier: Apache-2.0
"""The command lines of README and docs name what there is: topics, types, fields, parameters."""

import argparse
import ast
import importlib
import re
import shlex
from pathlib import Path

import pytest
import yaml
from kits.interface_table import SPACE, full, latched, table

from stack_counter.cli.main import _make_parser
from stack_counter.config import CollectorConfig, CounterConfig, ReconstructorConfig, build_section

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "data" / "README.md",
         *sorted((ROOT / "docs").glob("*.md"))]
NODES = {"collector": CollectorConfig, "reconstructor": ReconstructorConfig,
         "counter": CounterConfig}
OTHERS = {"/robot_state_publisher": {"robot_description"}}  # nodes of a cell, and parameters


def command_lines(page):
    """Words of each command line that stands alone, and of ROS's own with arguments in a sentence.
    """
    text = page.read_text().replace("\\\n", " ")
    alone = re.findall(r"^ *((?:ros2|(?:\.venv/bin/)?stack-counter) .*)", text, re.MULTILINE)
    in_sentences = re.findall(r"`(ros2 [^`\n]+)`", text)
    for line in [*(line for line in alone if "`" not in line), *in_sentences]:
        words = shlex.split(line.partition(" > ")[0], comments=True)
        words[0] = words[0].removeprefix(".venv/bin/")
        if words[0] == "stack-counter" or len(words) > 3:
            yield words


def interface(name):
    """Class of a type such as std_srvs/srv/Trigger."""
    package, group, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), kind)


def rows(how):
    """Types by full name of what the nodes publish, serve or offer."""
    return {full(name): kind for _, h, name, kind in table() if h == how}


def check_fields(kind, text):
    """Makes a message of its YAML; its class refuses fields and values that it does not have."""
    kind(check_fields=True, **(yaml.safe_load(text) if text else {}))


def section_of(node):
    return NODES[node.removeprefix(f"{SPACE}/")]


def parsed(words, *options):
    """Options, and the words that are none."""
    parser = argparse.ArgumentParser(exit_on_error=False, allow_abbrev=False)
    for name, fields in options:
        parser.add_argument(name, **fields)
    parser.add_argument("rest", nargs="*")
    return parser.parse_intermixed_args(words)


def flags(*names):
    return [(name, {"action": "store_true"}) for name in names]


def check_run(words):
    package, name, marker, *arguments = words
    assert (package, marker) == ("stack_counter", "--ros-args")
    options = parsed(arguments, ("-p", {"action": "append", "default": []}),
                     ("--params-file", {}), ("--enclave", {}))
    assert not options.rest
    values = dict(setting.split(":=", 1) for setting in options.p)
    build_section(NODES[name], {key: yaml.safe_load(value) for key, value in values.items()})
    assert options.params_file is None or (ROOT / options.params_file).is_file()
    assert options.enclave in (None, f"{SPACE}/{name}")


def check_launch(words):
    package, name, *arguments = words
    assert package == "stack_counter"
    tree = ast.parse((ROOT / "launch" / name).read_text())
    declared, = (node.value for node in tree.body if isinstance(node, ast.Assign)
                 and node.targets[0].id == "ARGUMENTS")
    known = {key.value for key in declared.keys} | {"params_file", "log_level"}
    assert {argument.split(":=")[0] for argument in arguments} <= known


def check_service(words):
    verb, name, kind, *values = words
    assert verb == "call" and rows("serves")[name] == kind
    check_fields(interface(kind).Request, *(values or [""]))


def check_action(words):
    verb, *arguments = words
    name, kind, values = parsed(arguments, *flags("--feedback")).rest
    assert verb == "send_goal" and rows("offers")[name] == kind
    check_fields(interface(kind).Goal, values)


def check_topic(words):
    """Any flag of QoS takes the others from best effort: what was latched then never comes."""
    verb, *arguments = words
    options = parsed(arguments, *flags("--once"), ("--field", {}), ("--qos-durability", {}),
                     ("--qos-reliability", {}))
    name, = options.rest
    assert verb == "echo"
    fields = interface(rows("publishes")[name]).get_fields_and_field_types()
    assert options.field is None or options.field in fields
    assert (options.qos_durability, options.qos_reliability) == (
        ("transient_local", "reliable") if name in latched() else (None, None))


def check_param(words):
    verb, *arguments = words
    node, name, *value = parsed(arguments, *flags("--hide-type")).rest
    if node in OTHERS:
        assert verb == "get" and name in OTHERS[node]
        return
    section = section_of(node)
    if verb == "set":
        build_section(section, {name: yaml.safe_load(value[0])})
        assert section.__dataclass_fields__[name].metadata["runtime"]
    else:
        assert verb in ("get", "describe") and name in section.__dataclass_fields__


def check_security(words):
    verb, keystore, *rest = words
    assert (verb, len(rest)) in (
        ("create_keystore", 0), ("create_enclave", 1), ("create_permission", 2))
    assert all(enclave.removeprefix(f"{SPACE}/") in {"$node", *NODES} for enclave in rest[:1])
    assert all((ROOT / path).is_file() for path in rest[1:])


CHECKS = {"run": check_run, "launch": check_launch, "service": check_service,
          "action": check_action, "topic": check_topic, "param": check_param,
          "security": check_security}


def check(words):
    if words[0] == "ros2":
        CHECKS[words[1]](words[2:])
    else:  # X stands for a number
        _make_parser().parse_args(["1" if word == "X" else word for word in words[1:]])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_line_names_what_there_is(page):
    pytest.importorskip("stack_counter_msgs.msg")
    for words in command_lines(page):
        try:
            check(words)
        except (Exception, SystemExit) as error:
            raise AssertionError(f"{shlex.join(words)}: {error!r}") from error


def test_the_readme_has_lines_of_every_kind():
    seen = {tuple(words[:2]) for words in command_lines(ROOT / "README.md")}
    assert {("ros2", kind) for kind in CHECKS if kind != "security"} <= seen
    assert {("stack-counter", name) for name in ("replay", "run", "part", "simulate")} <= seen


@pytest.mark.parametrize("line", [
    "ros2 topic echo --once --qos-durability transient_local /stack_counter/result",
    "ros2 topic echo --once /stack_counter/no_such_topic",
    "ros2 topic echo --field volume /stack_counter/running_count",
    "ros2 service call /stack_counter/start_scan std_srvs/srv/Trigger",
    "ros2 service call /stack_counter/start_scan stack_counter_msgs/srv/StartScan '{prat: nut}'",
    "ros2 run stack_counter collector --ros-args -p record_max_mb:=much",
    "ros2 launch stack_counter stack_counter.launch.py prat:=nut",
    "ros2 param set /stack_counter/reconstructor min_views 4",
    "stack-counter replay bags/demo --prat nut"])
def test_a_line_that_would_not_work_is_noticed(line, capsys):
    pytest.importorskip("stack_counter_msgs.msg")
    with pytest.raises((Exception, SystemExit)):
        check(shlex.split(line))
