# SPDX-License-Identifier: Apache-2.0
"""Results in the OPC UA server, read by a client."""

import datetime
import socket
import time
from contextlib import contextmanager, suppress

import pytest

pytest.importorskip("asyncua", reason="the extra opcua is not installed")

from asyncua import ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.sync import Client
from kits.flat_results import STAMP, flat, write_certificate

from stack_counter.bridges.opcua import APPLICATION_URI, NAMESPACE_URI, OpcuaSink
from stack_counter.bridges.settings import OpcuaConfig
from stack_counter.bridges.sinks import SinkThread
from stack_counter.display.result_schema import FLAT_FIELDS
from stack_counter.errors import ConfigError

PATIENCE_S = 120.0


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def wait(condition, what):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited for {what}"
        time.sleep(0.02)


@contextmanager
def serving(**settings):
    """A sink that listens, and its address."""
    port = free_port()
    sink = SinkThread([OpcuaSink(OpcuaConfig(port=port, **settings))])

    def listens():
        sink.check()
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    try:
        wait(listens, "the server")
        yield sink, f"opc.tcp://127.0.0.1:{port}/stack_counter"
    finally:
        sink.close()


def check_refused(client):
    """Tries to connect, and ends the client's thread."""
    with pytest.raises((ua.UaError, OSError)):
        client.connect()
    with suppress(ua.UaError, OSError):
        client.disconnect()


@pytest.fixture(scope="module")
def server():
    with serving(regions=("", "left")) as made:
        yield made


@pytest.fixture
def read(server):
    """Reads a node by its path below StackCounter."""
    with Client(server[1]) as client:
        index = client.get_namespace_index(NAMESPACE_URI)

        def read(path):
            return client.get_node(f"ns={index};s=StackCounter.{path}").read_data_value(
                raise_on_bad_status=False)
        read.client, read.index = client, index
        yield read


def test_each_value_is_a_node_that_has_no_data_before_the_first_result(read):
    root = read.client.nodes.objects.get_child(f"{read.index}:StackCounter")
    names = [node.read_browse_name().Name for node in root.get_children()]
    assert names == ["available", *FLAT_FIELDS, "left"]
    assert read("available").Value.Value is False
    for name in FLAT_FIELDS:
        assert read(f"left.{name}").StatusCode.value == ua.StatusCodes.BadNoData
        node = read.client.get_node(f"ns={read.index};s=StackCounter.left.{name}")
        assert node.read_description().Text == FLAT_FIELDS[name]["description"]


def test_a_result_comes_with_types_and_the_stamp_of_its_last_view(server, read):
    sink, _ = server
    sink.set_available(True)
    sink.put(flat(600))
    wait(lambda: read("count").Value.Value == 600, "the count")
    stamp = datetime.datetime.fromisoformat(STAMP.replace("Z", "+00:00"))
    for name, value, kind in [
            ("count", 600, "Int64"), ("count_interval.0", 550, "Int64"), ("gamma", 0.6, "Double"),
            ("schema_version", 1, "Int64"), ("status", "degraded", "String"),
            ("reasons", '["one_side"]', "String"), ("views.skipped", '{"no_tf": 2}', "String")]:
        seen = read(name)
        assert (seen.Value.Value, seen.Value.VariantType) == (value, ua.VariantType[kind])
        assert seen.StatusCode.is_good() and seen.SourceTimestamp.replace(
            tzinfo=datetime.UTC) == stamp
        node = read.client.get_node(f"ns={read.index};s=StackCounter.{name}")
        assert node.read_data_type() == ua.NodeId(ua.VariantType[kind].value)
    assert read("available").Value.Value is True
    # A scan without a count has none of the one before.
    sink.put(flat(None))
    wait(lambda: read("status").Value.Value == "error", "the error")
    assert read("count").StatusCode.value == ua.StatusCodes.BadNoData
    assert read("error").Value.Value == "1 view used"


def test_a_region_that_nobody_named_gets_nodes_with_its_first_result(server, read):
    sink, _ = server
    sink.put(flat(8, "right"))
    root = read.client.nodes.objects.get_child(f"{read.index}:StackCounter")
    wait(lambda: any(n.read_browse_name().Name == "right" for n in root.get_children()), "nodes")
    wait(lambda: read("right.count").Value.Value == 8, "its count")
    assert read("left.count").StatusCode.value == ua.StatusCodes.BadNoData


def test_nobody_may_write_and_no_name_opens_more(server, read):
    node = read.client.get_node(f"ns={read.index};s=StackCounter.count")
    with pytest.raises(ua.UaStatusCodeError):
        node.write_value(ua.Variant(3, ua.VariantType.Int64))
    admin = Client(server[1])
    admin.set_user("admin")
    check_refused(admin)


def test_a_password_and_encryption(tmp_path, monkeypatch):
    certificate, key = write_certificate(tmp_path, APPLICATION_URI)
    settings = {"username": "plc", "certificate_file": str(certificate), "key_file": str(key)}
    with pytest.raises(ConfigError, match="no environment variable STACK_COUNTER_OPCUA_PASSWORD"):
        OpcuaSink(OpcuaConfig(**settings))
    monkeypatch.setenv("STACK_COUNTER_OPCUA_PASSWORD", "secret")
    with serving(**settings) as (sink, url):
        def client(password, encrypted=True):
            made = Client(url)
            if encrypted:
                made.set_user("plc")
                made.set_password(password)
                made.set_security(SecurityPolicyBasic256Sha256, str(certificate), str(key),
                                  server_certificate=str(certificate),
                                  mode=ua.MessageSecurityMode.SignAndEncrypt)
                made.application_uri = APPLICATION_URI
            return made

        check_refused(client("wrong"))
        check_refused(client("", encrypted=False))
        with client("secret") as reader:
            assert NAMESPACE_URI in reader.get_namespace_array()


def test_what_cannot_be_served_is_named(server, tmp_path):
    port = int(server[1].split(":")[2].split("/")[0])
    sink = SinkThread([OpcuaSink(OpcuaConfig(port=port))])
    try:
        with pytest.raises(ConfigError, match=f"cannot listen on 127.0.0.1:{port} .*is free"):
            wait(lambda: sink.check(), "the refusal")
    finally:
        sink.close()
    with pytest.raises(ConfigError, match="no file nowhere.pem"):
        OpcuaSink(OpcuaConfig(certificate_file="nowhere.pem", key_file="key.pem"))
