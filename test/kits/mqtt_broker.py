# SPDX-License-Identifier: Apache-2.0
"""A real MQTT broker on a port of its own, and what somebody reads there."""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading
from contextlib import contextmanager

from amqtt.broker import Broker
from paho.mqtt.client import CallbackAPIVersion, Client
from paho.mqtt.enums import MQTTProtocolVersion

PATIENCE_S = 60.0


def free_port():
    """A port on which nobody listens now."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@contextmanager
def broker(port, passwords="", tls=None):
    """Runs a broker.

    Args:
        port: on which it listens.
        passwords: file of users and their hashed passwords; empty: anybody may come.
        tls: paths of certificate and key; None: in clear.
    """
    listener = {"type": "tcp", "bind": f"127.0.0.1:{port}"}
    if tls:
        listener |= {"ssl": True, "certfile": str(tls[0]), "keyfile": str(tls[1])}
    plugins = {"amqtt.plugins.authentication.FileAuthPlugin": {"password_file": str(passwords)}} \
        if passwords else {"amqtt.plugins.authentication.AnonymousAuthPlugin":
                           {"allow_anonymous": True}}
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    async def start():
        made = Broker({"listeners": {"default": listener}, "plugins": plugins}, loop=loop)
        await made.start()
        return made

    def call(coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, loop).result(PATIENCE_S)

    running = call(start())
    try:
        yield
    finally:
        call(running.shutdown())
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


class Reader:
    """Somebody who reads all topics: the last payload of each, and all of them in order."""

    def __init__(self, port, user=None, password=None, ca=None):
        self.last, self.payloads, self.retained = {}, [], set()
        self._news = threading.Condition()
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv311)
        self._client.username_pw_set(user, password)
        if ca:
            self._client.tls_set_context(ssl.create_default_context(cafile=ca))
        self._client.on_connect = lambda client, *_: client.subscribe("#", 1)
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def _on_message(self, client, userdata, message):
        with self._news:
            self.last[message.topic] = message.payload.decode()
            self.payloads.append(message.payload.decode())
            self.retained |= {message.topic} if message.retain else set()
            self._news.notify_all()

    def wait(self, condition, what):
        """Waits until `condition(self)` holds."""
        with self._news:
            assert self._news.wait_for(lambda: condition(self), PATIENCE_S), \
                f"waited for {what}; came: {self.last}"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._client.disconnect()
        self._client.loop_stop()
