# SPDX-License-Identifier: Apache-2.0
"""Files of settings of the bridges."""

import dataclasses
from pathlib import Path

import pytest

from stack_counter.bridges.settings import (
    BridgeConfig,
    MqttConfig,
    OpcuaConfig,
    load_bridges,
    password_of,
)
from stack_counter.errors import ConfigError

CONFIG = Path(__file__).parents[2] / "config"


@pytest.mark.parametrize("name, section", [("mqtt", MqttConfig), ("opcua", OpcuaConfig)])
def test_shipped_files_hold_every_default_and_its_description(name, section):
    assert load_bridges(CONFIG / f"{name}.yaml") == BridgeConfig(**{name: section()})
    lines = (CONFIG / f"{name}.yaml").read_text().splitlines()
    for setting in dataclasses.fields(section):
        place, = (i for i, line in enumerate(lines) if line.startswith(f"  {setting.name}:"))
        assert lines[place - 1] == f"  # {setting.metadata['doc']}"


def test_one_file_may_set_up_both(tmp_path):
    (tmp_path / "both.yaml").write_text("mqtt: {qos: 2}\nopcua: {regions: [left, right]}\n")
    assert load_bridges(tmp_path / "both.yaml") == BridgeConfig(
        MqttConfig(qos=2), OpcuaConfig(regions=("left", "right")))


@pytest.mark.parametrize("text, said", [
    ("", "expected a section mqtt, opcua or both"), ("[mqtt]", "expected a section"),
    ("mqtt: {}\nmodbus: {}", "expected a section"), ("mqtt: {", "is no YAML"),
    ("mqtt: 5", "mqtt is 5; expected settings"), ("mqtt: {qos: 3}", "qos is 3; expected 0 to 2"),
    ("mqtt: {password: x}", "unknown setting 'password'; expected one of"),
    ("mqtt: {null: x}", "unknown setting None; expected one of"),
    ('mqtt: {"a\\nb": x}', "unknown setting 'a"),
    ("mqtt: {port: '1883'}", "port is '1883'; expected int"),
    ("mqtt: {topic: 'a/#'}", "expected a topic without"),
    ("mqtt: {ca_file: ca.pem}", "expected tls: true"),
    ("opcua: {regions: left}", "expected a list of names"),
    ("opcua: {key_file: key.pem}", "expected both or none"),
    ("opcua: {username: plc}", "the password would travel in clear")])
def test_what_cannot_be_is_refused(tmp_path, text, said):
    (tmp_path / "bridge.yaml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_bridges(tmp_path / "bridge.yaml")
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_the_password_is_of_the_environment(monkeypatch):
    assert password_of(MqttConfig()) is None
    config = MqttConfig(username="robot", password_variable="CELL")
    monkeypatch.setenv("CELL", "secret")
    assert password_of(config) == "secret"
    monkeypatch.delenv("CELL")
    with pytest.raises(ConfigError, match="no environment variable CELL"):
        password_of(config)
