# SPDX-License-Identifier: Apache-2.0
"""What every file of a recording gives, whatever its format."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from functools import cached_property, partial
from io import StringIO
from typing import Any, Protocol

import numpy as np
import yaml
import zstandard
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.serde import SerdeError

from stack_counter.bag.formats.decompression import decompress_zstd
from stack_counter.bag.message_definitions import known_types, message_definition
from stack_counter.errors import BagError, StackCounterError

# Later than any message.
NEVER_NS = 2**63 - 1
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_TRANSIENT_LOCAL = 1  # durability, as recorders before Jazzy write it
# Types of ROS 1 that ROS 2 has under another name.
_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


@dataclass(frozen=True)
class Record:
    """One message as recorded.

    Attributes:
        topic: on which it was published.
        log_time_ns: time of recording, ns since 1970.
        data: serialised message, CDR.
        decode: makes the message of `data`; raises whatever the decoder raises.
    """

    topic: str
    log_time_ns: int
    data: bytes
    decode: Callable[[], Any]


@contextmanager
def decoding(record: Record) -> Iterator[None]:
    """Has errors of a message that is decoded and used name its topic.

    Raises:
        BagError: it is not what its type is, as recordings define types themselves.
    """
    try:
        yield
    except StackCounterError:
        raise
    except Exception as error:  # the decoder's errors are of many classes
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise BagError(f"a message on {record.topic} does not decode: {said}; expected what "
                       "ROS 2 defines") from error


class RecordingFile(Protocol):
    """One file of a recording; it is never read as a whole.

    Attributes:
        topics: type name and number of messages by topic, of topics that have messages.
        latched: topics that were recorded from publishers who offer old messages to late
            subscribers.
        metadata: values by key, by name of the metadata.
        start_ns: earliest log time, ns since 1970; `NEVER_NS` without messages.
        end_ns: latest log time, ns since 1970; 0 without messages.
        size: of what is read, bytes.
    """

    topics: dict[str, tuple[str, int]]
    latched: set[str]
    metadata: dict[str, dict[str, str]]
    start_ns: int
    end_ns: int
    size: int

    @property
    def truncated(self) -> bool:
        """Whether the file ends early, or a part of it is damaged and was left out."""

    def records(self, topics: Set[str], start_ns: int, end_ns: int) -> Iterator[Record]:
        """Messages of these topics from one time to before another, in log-time order."""

    def times_ns(self, topics: Set[str]) -> np.ndarray:
        """Log times, ns, where messages of these topics are: (n,) int64, in rising order.

        Where messages are stored in chunks it is the time of each chunk that has some.
        """


class TopicDecoder:
    """Makes records of one topic's messages as a file stores them.

    Attributes:
        topic: name.
        kind: name of the type as ROS 2 spells it, or empty where the file does not say it.
    """

    def __init__(self, topic: str, kind: str, definition: str = "", encoding: str = "cdr"):
        """Decodes nothing yet: most topics of a recording are of no interest.

        Args:
            topic: name.
            kind: name of the type; ROS 1 spells it without `msg/`.
            definition: text of the type (`ros2msg`); empty: the type's name must be known.
            encoding: how messages are serialised, `cdr` or `ros1`.
        """
        kind = kind if kind.count("/") != 1 else kind.replace("/", "/msg/")
        self.topic, self.kind = topic, _RENAMED.get(kind, kind)
        self._definition, self._encoding = definition, encoding

    def record(self, log_time_ns: int, stored: bytes) -> Record:
        """The record of a message, which may be compressed by itself.

        Raises:
            BagError: the message is damaged, or how it is serialised is not known.
        """
        data = self._to_cdr(_uncompressed(stored, self.topic))
        return Record(self.topic, log_time_ns, data, partial(self._decode, data))

    def _to_cdr(self, data: bytes) -> bytes:
        if self._encoding == "ros1":
            self._require_known()
            try:
                return bytes(known_types().ros1_to_cdr(data, self.kind))
            except SerdeError as error:
                raise BagError(f"a message on {self.topic} is no {self.kind} of ROS 1: {error}"
                               ) from error
        if self._encoding != "cdr":
            raise BagError(f"{self.topic} is encoded as '{self._encoding}'; expected cdr or ros1")
        return data

    def _require_known(self) -> None:
        """Raises BagError: the type is known neither by its text nor by its name."""
        if self.kind not in known_types().types:
            raise BagError(f"{self.topic} has type '{self.kind}', which the recording does not "
                           "define; expected its definition (ros2msg), or a type of ROS 2 Jazzy")

    def _decode(self, data: bytes) -> Any:
        return self._decoder(data)

    @cached_property
    def _decoder(self) -> Callable[[bytes], Any]:
        if not self._definition or self._encoding == "ros1":
            self._require_known()
            self._definition = message_definition(self.kind)
        # The parser prints a line that it cannot read, beside the error that it raises.
        with redirect_stderr(StringIO()):
            decoder = DecoderFactory().decoder_for(
                "cdr", Schema(id=1, name=self.kind, encoding="ros2msg",
                              data=self._definition.encode()))
        assert decoder is not None  # for the type checker: it is for CDR and ros2msg
        return decoder


def is_latched(profiles: str) -> bool:
    """Whether a recorder's YAML list of offered profiles has one of transient local durability."""
    try:
        return any(profile.get("durability") in ("transient_local", _TRANSIENT_LOCAL)
                   for profile in yaml.safe_load(profiles) or [])
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, RecursionError):
        return False


def _uncompressed(stored: bytes, topic: str) -> bytes:
    """A message as it was before the recorder compressed it; CDR never begins as zstd does."""
    if not stored.startswith(ZSTD_MAGIC):
        return stored
    try:
        return b"".join(decompress_zstd(stored))
    except zstandard.ZstdError as error:
        raise BagError(f"a compressed message on {topic} is damaged: {error}") from error
