# SPDX-License-Identifier: Apache-2.0
"""`stack-counter bridge` as a command; node and sinks are tested with their own code."""

import sys

import pytest
from kits.command import run

from stack_counter.bridges.settings import BridgeConfig, MqttConfig, OpcuaConfig
from stack_counter.cli.bridge import _warn_of_clear_text


@pytest.mark.parametrize("name, package", [("mqtt", "aiomqtt"), ("opcua", "asyncua")])
def test_what_is_missing_is_named_with_how_to_get_it(monkeypatch, capsys, name, package):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, f"stack_counter.bridges.{name}", raising=False)
    code, _, err = run(capsys, "bridge", f"config/{name}.yaml")
    assert code == 2 and f"pip install 'stack_counter[{name}]'" in err


def test_a_file_that_is_not_there_is_named(capsys):
    code, _, err = run(capsys, "bridge", "no_such.yaml")
    assert code == 2 and "no_such.yaml" in err


@pytest.mark.parametrize("config, said", [
    (BridgeConfig(MqttConfig(), OpcuaConfig()), ""),
    (BridgeConfig(MqttConfig(host="broker.plant", tls=True)), ""),
    (BridgeConfig(MqttConfig(host="10.0.0.5", username="robot")), "results and password travel"),
    (BridgeConfig(opcua=OpcuaConfig(host="0.0.0.0")), "whoever reaches this address")])
def test_who_can_read_along_is_said(capsys, config, said):
    _warn_of_clear_text(config)
    err = capsys.readouterr().err
    assert said in err and bool(err) == bool(said)
