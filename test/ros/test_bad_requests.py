# SPDX-License-Identifier: Apache-2.0
"""Requests that a callback did not expect do not end the node, nor is a path taken from one."""

import dataclasses
import os
import subprocess
import sys

import pytest
from std_srvs.srv import Trigger

from stack_counter.config import CollectorConfig, Config, CounterConfig, ReconstructorConfig
from stack_counter.config.setting_fields import path_refusal
from stack_counter.errors import ConfigError
from stack_counter.ros import bad_requests
from stack_counter.ros.bad_requests import check_names, guarded
from stack_counter.ros.descriptors import describe_parameter
from stack_counter.ros.private_domain import PrivateDomain

FIELDS = {field.name: field for section in (CollectorConfig, ReconstructorConfig, CounterConfig)
          for field in dataclasses.fields(section)}
PATHS = {"part_catalogue", "rig", "robot_description_file", "record_folder",
         "container_catalogue", "prompts", "sam2_weights", "depth_weights", "report_folder",
         "weights", "encoder_weights", "visible_parts_weights", "result_log"}


class Lines(list):
    def error(self, text, **_):
        self.append(text)


def answer_of(callback, lines):
    with pytest.raises(StopIteration) as ended:
        guarded(Trigger, callback, lines)(Trigger.Request(), Trigger.Response()).send(None)
    return ended.value.value


def test_an_exception_is_logged_and_answered(monkeypatch):
    monkeypatch.setattr(bad_requests.rclpy, "ok", lambda: True)

    def fail(request, response):
        raise KeyError("a fault")

    async def fail_later(request, response):
        raise KeyError("a fault")

    async def succeed(request, response):
        response.success = True
        return response

    lines = Lines()
    assert answer_of(succeed, lines).success and not lines
    for callback in (fail, fail_later):
        assert answer_of(callback, lines) == Trigger.Response()
        assert "request of Trigger dropped" in lines[-1] and "a fault" in lines[-1]
    assert len(lines) == 2


def test_every_setting_that_names_a_file_is_known_as_one():
    assert {name for name, field in FIELDS.items() if field.metadata["path"]} == PATHS
    named = {field.name for section in dataclasses.fields(Config)
             for field in dataclasses.fields(section.default)
             if field.default == "" and field.metadata["doc"].startswith((
                 "file", "folder", "URDF", "safetensors"))}
    assert named <= PATHS


@pytest.mark.parametrize("name", sorted(PATHS))
def test_no_request_names_a_path(name):
    refused = path_refusal(FIELDS[name], "/etc/passwd")
    assert refused.startswith(f"{name} is '/etc/passwd', a path, which no request may name; ")
    assert f"-p {name}:=" in refused and "\n" not in refused
    assert not path_refusal(FIELDS[name], "")
    marks = path_refusal(FIELDS[name], "{parts: {points: [[3, 2]]}}")
    assert not marks if name == "prompts" else marks
    assert "a path" in describe_parameter(FIELDS[name]).additional_constraints


def test_other_settings_name_no_path():
    assert not path_refusal(FIELDS["part"], "../bolt")


SETS_PARAMETERS = """
import rclpy
from rclpy.parameter import Parameter
from stack_counter.config import ReconstructorConfig
from stack_counter.ros.lifecycle import ManagedNode

class Idle(ManagedNode):
    def setup(self, config):
        pass

    def apply_runtime_config(self, config):
        if "fault" in config.prompts:
            raise KeyError("a fault")

rclpy.init()
node = Idle("reconstructor", ReconstructorConfig)
for name, value in [("report_folder", "reports"), ("report_folder", "/"), ("prompts", "/etc/x")]:
    print(node.set_parameters([Parameter(name, value=value)])[0].reason[:60])
node.trigger_configure()
for value in ("/etc/x", "{a: 1}", "{a: fault}"):
    print(node.set_parameters([Parameter("prompts", value=value)])[0].reason[:40])
print(node.get_parameter("report_folder").value, node.get_parameter("prompts").value)
"""


def test_a_node_keeps_the_paths_that_it_was_started_with():
    with PrivateDomain() as domain:
        done = subprocess.run([sys.executable, "-c", SETS_PARAMETERS, "--ros-args", "-p",
                               "report_folder:=reports"], capture_output=True, text=True,
                              timeout=60, env={**os.environ, **domain.environment})
    refused = "is '/etc/x', a path, which no request may name; expected"
    assert done.stdout.splitlines() == [
        "", "report_folder is '/', a path, which no request may name; exp",
        f"prompts {refused}"[:60], f"prompts {refused}"[:40], "", "KeyError: 'a fault'",
        "reports {a: 1}"], done.stderr


@pytest.mark.parametrize("name", ["a\n[ERROR] forged", "bell\7", "x" * 201, "\u2028"])
def test_a_name_that_does_not_stay_on_one_line_is_refused(name):
    with pytest.raises(ConfigError, match="scan_id .* on one line") as caught:
        check_names(scan_id=name)
    assert str(caught.value).isprintable()
    check_names(scan_id="", part="Mutter \u00bc\u2033, verzinkt")
