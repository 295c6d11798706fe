# SPDX-License-Identifier: Apache-2.0
"""Results to an MQTT broker: retained, in order, with a last will."""

from __future__ import annotations

import asyncio
import json
import logging
import ssl
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import aiomqtt

from stack_counter.bridges.settings import MqttConfig, password_of
from stack_counter.errors import ConfigError

_LOGGER = logging.getLogger(__name__)
ONLINE, OFFLINE = "online", "offline"


@dataclass(frozen=True)
class MqttSettings:
    """How patient the client is; all are chosen.

    Attributes:
        retry_min_s: pause before the first try to connect again, seconds; it doubles each time.
        retry_max_s: longest such pause, seconds.
        backlog: messages that wait for a broker before the oldest are dropped.
    """

    retry_min_s: float = 1.0
    retry_max_s: float = 60.0
    backlog: int = 1000


SETTINGS = MqttSettings()


class MqttSink:
    """Publishes every result, and keeps the last of each region retained at the broker."""

    def __init__(self, config: MqttConfig):
        """Connects to nothing yet.

        Raises:
            ConfigError: there is no password, or a certificate cannot be used.
        """
        self._config, self._password = config, password_of(config)
        self._tls = _tls_context(config) if config.tls else None
        self._availability = f"{config.topic}/availability"
        self._last = {self._availability: OFFLINE}  # payloads by topic, as they are to be retained
        self._waiting: deque[tuple[str, str]] = deque(maxlen=SETTINGS.backlog)
        self._news = asyncio.Event()
        self._said = ""  # why there is no connection, as it was logged last

    def put(self, result: Mapping[str, Any]) -> None:
        """Has a flat result published on the topic of its region."""
        levels = [self._config.topic, result["region"], "result"]
        self._publish_soon("/".join(filter(None, levels)), json.dumps(result))

    def set_available(self, available: bool) -> None:
        """Has it published whether a counter is there."""
        self._publish_soon(self._availability, ONLINE if available else OFFLINE)

    def _publish_soon(self, topic: str, payload: str) -> None:
        self._last[topic] = payload
        self._waiting.append((topic, payload))
        self._news.set()

    async def run(self) -> None:
        """Publishes until it is cancelled, and connects again as often as it takes."""
        pause_s = SETTINGS.retry_min_s
        while True:
            try:
                async with self._client() as client:
                    _LOGGER.info("mqtt: connected to %s:%d; results are on %s/#",
                                 self._config.host, self._config.port, self._config.topic)
                    await self._restore(client)
                    self._said, pause_s = "", SETTINGS.retry_min_s
                    await self._serve(client)
            except aiomqtt.MqttError as error:
                self._say_lost(str(error))
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, SETTINGS.retry_max_s)

    def _client(self) -> aiomqtt.Client:
        c = self._config
        will = aiomqtt.Will(self._availability, OFFLINE, c.qos, retain=True)
        return aiomqtt.Client(c.host, c.port, username=c.username or None,
                              password=self._password, identifier=c.client_id or None,
                              keepalive=c.keepalive_s, will=will, tls_context=self._tls,
                              logger=_LOGGER.getChild("client"))

    async def _restore(self, client: aiomqtt.Client) -> None:
        """Publishes what is to be retained and does not wait: the broker may have forgotten it."""
        waiting = {topic for topic, _ in self._waiting}
        for topic, payload in list(self._last.items()):
            if topic not in waiting:
                await self._publish(client, topic, payload)

    async def _serve(self, client: aiomqtt.Client) -> None:
        """Publishes what comes until the connection is lost; says offline if it is cancelled."""
        tasks = [asyncio.ensure_future(self._publish_waiting(client)),
                 asyncio.ensure_future(_watch(client))]
        try:
            await asyncio.gather(*tasks)
        except asyncio.CancelledError:
            await self._publish(client, self._availability, OFFLINE)
            raise
        finally:
            for task in tasks:
                task.cancel()

    async def _publish_waiting(self, client: aiomqtt.Client) -> None:
        """Publishes in order; a message goes from the queue once the broker has it."""
        while True:
            while self._waiting:
                first = self._waiting[0]
                await self._publish(client, *first)
                if self._waiting[0] is first:  # otherwise it was dropped meanwhile
                    self._waiting.popleft()
            self._news.clear()
            await self._news.wait()

    async def _publish(self, client: aiomqtt.Client, topic: str, payload: str) -> None:
        await client.publish(topic, payload, self._config.qos, retain=True)

    def _say_lost(self, why: str) -> None:
        """Logs why there is no connection, once for as long as it is the same."""
        if why != self._said:
            _LOGGER.warning("mqtt: no connection to %s:%d: %s; trying again, every %.0f s in the "
                            "end", self._config.host, self._config.port, why,
                            SETTINGS.retry_max_s)
        self._said = why


async def _watch(client: aiomqtt.Client) -> None:
    """Waits until the connection is lost. Raises MqttError then."""
    async for _ in client.messages:
        pass  # nothing is subscribed to


def _tls_context(config: MqttConfig) -> ssl.SSLContext:
    """Returns the context for a connection. Raises ConfigError: a certificate cannot be used."""
    try:
        context = ssl.create_default_context(cafile=config.ca_file or None)
        if config.certificate_file:
            context.load_cert_chain(config.certificate_file, config.key_file or None)
    except OSError as error:  # SSLError is one
        files = [config.ca_file, config.certificate_file, config.key_file]
        raise ConfigError(f"mqtt: the certificates {[f for f in files if f]} cannot be used: "
                          f"{error}; expected PEM files") from error
    return context
