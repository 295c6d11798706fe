# SPDX-License-Identifier: Apache-2.0
"""A client of the Foxglove WebSocket protocol, as the Foxglove app is one."""

import json
import re
import struct
import time

from websockets.sync.client import connect

PROTOCOL = "foxglove.sdk.v1"
_REFUSED = re.compile(r"Unknown channel ID: (\d+)")
MESSAGE_DATA = 1  # first byte of a binary frame that holds a message


class FoxgloveClient:
    """Connects to a server, and subscribes to all topics that a test names."""

    def __init__(self, port, *topics):
        self._connection = connect(f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL],
                                   max_size=None)
        self._wanted = set(topics)
        self.channels = {}  # what the server says of a topic, by its name
        self._topic_of = {}  # topic by the number of our subscription

    def __enter__(self):
        self._socket = self._connection.__enter__()
        return self

    def __exit__(self, *error):
        self._connection.__exit__(*error)

    def receive(self, seconds):
        """Returns topic and bytes of the next message.

        Raises:
            TimeoutError: none comes in time.
        """
        while True:
            frame = self._socket.recv(seconds)
            if isinstance(frame, bytes):
                kind, subscription, _ = struct.unpack_from("<BIQ", frame)
                if kind == MESSAGE_DATA:
                    return self._topic_of[subscription], frame[13:]
            else:
                self._on_text(json.loads(frame))

    def _on_text(self, message):
        for channel in message.get("channels", []) if message["op"] == "advertise" else []:
            self.channels[channel["topic"]] = channel
            if channel["topic"] in self._wanted or not self._wanted:
                self._topic_of[channel["id"]] = channel["topic"]
                self._subscribe(channel["id"])
        for number in message["channelIds"] if message["op"] == "unadvertise" else []:
            self._topic_of.pop(number, None)
        # A server may advertise a channel before it takes subscriptions to it.
        refused = _REFUSED.fullmatch(message.get("message", ""))
        if refused and int(refused[1]) in self._topic_of:
            time.sleep(0.1)
            self._subscribe(int(refused[1]))

    def _subscribe(self, number):
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": [
            {"id": number, "channelId": number}]}))
