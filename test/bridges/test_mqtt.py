# SPDX-License-Identifier: Apache-2.0
"""Results at a real MQTT broker."""

import json
import logging
import subprocess
import sys
import threading
from contextlib import contextmanager

import pytest

pytest.importorskip("aiomqtt", reason="the extra mqtt is not installed")
pytest.importorskip("amqtt", reason="there is no broker: amqtt is not installed")

from kits.flat_results import flat, write_certificate
from kits.mqtt_broker import PATIENCE_S, Reader, broker, free_port

from stack_counter.bridges import mqtt
from stack_counter.bridges.mqtt import MqttSettings, MqttSink
from stack_counter.bridges.settings import MqttConfig
from stack_counter.bridges.sinks import SinkThread
from stack_counter.errors import ConfigError

RESULT, AVAILABILITY = "cell/result", "cell/availability"


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(mqtt, "SETTINGS", MqttSettings(retry_min_s=0.05, retry_max_s=0.2))


@contextmanager
def sink_to(port, **settings):
    """A sink that runs."""
    thread = SinkThread([MqttSink(MqttConfig(port=port, topic="cell", **settings))])
    try:
        yield thread
    finally:
        thread.close()


@contextmanager
def refusal():
    """An event that is set once the sink says that it has no connection, and its lines."""
    said = threading.Event()
    lines = []

    class Handler(logging.Handler):
        def emit(self, record):
            if "no connection" in record.getMessage():
                lines.append(record.getMessage())
                said.set()

    handler = Handler()
    logging.getLogger(mqtt.__name__).addHandler(handler)
    try:
        yield said, lines
    finally:
        logging.getLogger(mqtt.__name__).removeHandler(handler)


@pytest.mark.parametrize("qos", [0, 1, 2])
def test_the_last_result_of_each_region_is_retained(qos):
    port = free_port()
    with broker(port):
        with Reader(port) as early, sink_to(port, qos=qos) as sink:
            sink.set_available(True)
            early.wait(lambda r: r.last.get(AVAILABILITY) == "online", "the sign of life")
            for result in (flat(600), flat(601), flat(7, "left"), flat(None, "right")):
                sink.put(result)
            early.wait(lambda r: "cell/right/result" in r.last, "the results")
            counts = [json.loads(p)["count"] for p in early.payloads if p.startswith("{")]
            assert counts == [600, 601, 7, None]
            with Reader(port) as late:
                late.wait(lambda r: "cell/right/result" in r.last and len(r.last) == 4,
                          "what was retained")
                assert late.retained == set(late.last)
                assert json.loads(late.last[RESULT]) == flat(601)
                assert json.loads(late.last["cell/left/result"])["count"] == 7
        with Reader(port) as later:  # the sink has said goodbye
            later.wait(lambda r: r.last.get(AVAILABILITY) == "offline" and RESULT in r.last,
                       "the goodbye")
            assert json.loads(later.last[RESULT])["count"] == 601


def test_a_broker_that_comes_late_or_forgets_gets_all():
    port = free_port()
    with refusal() as (said, lines), sink_to(port) as sink:
        sink.set_available(True)
        sink.put(flat(1))
        assert said.wait(PATIENCE_S)
        sink.put(flat(2, scan_id="scan 8"))
        for _ in range(2):  # the second broker knows nothing of the first
            with broker(port), Reader(port) as reader:
                reader.wait(lambda r: RESULT in r.last and json.loads(r.last[RESULT])["count"] == 2
                            and r.last.get(AVAILABILITY) == "online", "the results")
        assert len(lines) <= 4 and f"127.0.0.1:{port}" in lines[0]


def test_a_sink_that_dies_is_offline():
    """The last will: the connection ends without a goodbye."""
    port = free_port()
    code = f"""
import time
from stack_counter.bridges.mqtt import MqttSink
from stack_counter.bridges.settings import MqttConfig
from stack_counter.bridges.sinks import SinkThread
sink = SinkThread([MqttSink(MqttConfig(port={port}, topic="cell"))])
sink.set_available(True)
time.sleep(600)
"""
    with broker(port), Reader(port) as reader:
        process = subprocess.Popen([sys.executable, "-c", code])
        try:
            reader.wait(lambda r: r.last.get(AVAILABILITY) == "online", "the sign of life")
        finally:
            process.kill()
            process.wait()
        reader.wait(lambda r: r.last.get(AVAILABILITY) == "offline", "the last will")


def test_tls_and_a_password_of_the_environment(tmp_path, monkeypatch):
    from pwdlib import PasswordHash

    port, (certificate, key) = free_port(), write_certificate(tmp_path)
    passwords = tmp_path / "passwords"
    passwords.write_text(f"robot:{PasswordHash.recommended().hash('secret')}\n")
    settings = {"host": "localhost", "tls": True, "ca_file": str(certificate),
                "username": "robot", "password_variable": "CELL_PASSWORD"}
    monkeypatch.delenv("CELL_PASSWORD", raising=False)
    with pytest.raises(ConfigError, match="no environment variable CELL_PASSWORD"):
        MqttSink(MqttConfig(**settings))
    with broker(port, passwords, (certificate, key)):
        monkeypatch.setenv("CELL_PASSWORD", "wrong")
        with refusal() as (said, lines), sink_to(port, **settings) as sink:
            assert said.wait(PATIENCE_S)
        assert "secret" not in lines[0] and "wrong" not in lines[0]
        monkeypatch.setenv("CELL_PASSWORD", "secret")
        with refusal() as (said, lines), sink_to(port, **{**settings, "ca_file": ""}):
            assert said.wait(PATIENCE_S) and "certificate" in lines[0].lower()
        with sink_to(port, **settings) as sink, \
                Reader(port, "robot", "secret", str(certificate)) as reader:
            sink.put(flat(5))
            reader.wait(lambda r: RESULT in r.last, "the result")


def test_a_certificate_that_is_none_is_named(tmp_path):
    (tmp_path / "ca.pem").write_text("no certificate")
    with pytest.raises(ConfigError, match="ca.pem.*expected PEM files"):
        MqttSink(MqttConfig(tls=True, ca_file=str(tmp_path / "ca.pem")))
