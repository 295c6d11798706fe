"""Reads recorded bags: rosbag2 folders and bare .mcap files, whole or cut short; no ROS needed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcap_ros2.decoder import DecoderFactory

from stack_counter.assembler import ViewAssembler
from stack_counter.bag.mcap_file import McapFile
from stack_counter.config import CollectorConfig
from stack_counter.errors import BagError
from stack_counter.types import View

LABELS_TOPIC = "/camera/labels"


@dataclass(frozen=True)
class Record:
    """One message as recorded: `data` is CDR, `log_time_ns` the time of recording."""

    topic: str
    log_time_ns: int
    data: bytes
    decode: Callable[[], Any]


class BagReader:
    """All files of a bag as one.

    Attributes:
        topics: type name and number of messages by topic.
        truncated: whether a file ends early.
    """

    def __init__(self, path: Path):
        """Looks through the bag once.

        Raises:
            FileNotFoundError: no such path.
            BagError: not an mcap file, or a folder without one.
        """
        if not path.exists():
            raise FileNotFoundError(f"no bag {path}; expected a rosbag2 folder or .mcap file")
        paths = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
        if not paths:
            raise BagError(f"no .mcap file in {path}; it holds "
                           f"{sorted(p.name for p in path.iterdir())[:8]}")
        self._files = [McapFile(p) for p in paths]
        self._factory = DecoderFactory()
        types: dict[str, str] = {}
        counts: Counter[str] = Counter()
        for file in self._files:
            for schema, channel, _ in file.messages():
                types[channel.topic] = schema.name
                counts[channel.topic] += 1
        self.topics = {topic: (types[topic], counts[topic]) for topic in sorted(types)}

    @property
    def truncated(self) -> bool:
        """A file ends before its end."""
        return any(file.truncated for file in self._files)

    def records(self, topics: set[str]) -> Iterator[Record]:
        """The messages of these topics in log-time order."""
        for file in self._files:
            for schema, channel, message in file.messages():
                if channel.topic not in topics:
                    continue
                decoder = self._factory.decoder_for(channel.message_encoding, schema)
                if decoder is None:
                    raise BagError(f"{channel.topic} is encoded as '{channel.message_encoding}'; "
                                   "expected cdr")
                yield Record(channel.topic, message.log_time, message.data,
                             lambda decoder=decoder, data=message.data: decoder(data))


def fit_config(config: CollectorConfig, topics: dict[str, tuple[str, int]]) -> CollectorConfig:
    """The settings with topics and transports that the bag has.

    Raises:
        BagError: no colour images.
    """
    compressed = f"{config.color_topic}/compressed"
    if compressed not in topics and config.color_topic not in topics:
        raise BagError(f"no images on {config.color_topic} or {compressed}; the bag has "
                       f"{', '.join(topics) or 'no topics'}")
    labels = config.labels_topic or LABELS_TOPIC
    return replace(
        config, color_transport="raw" if config.color_topic in topics else "compressed",
        depth_topic=config.depth_topic if config.depth_topic in topics else "",
        labels_topic=labels if labels in topics else "")


def listened(config: CollectorConfig) -> list[str]:
    """The topics that a collector with these settings listens to."""
    suffix = "/compressed" if config.color_transport == "compressed" else ""
    poses = [config.pose_topic] if config.pose_source == "topic" else ["/tf", "/tf_static"]
    return [topic for topic in (config.color_topic + suffix, config.camera_info_topic,
                                config.depth_topic, config.labels_topic, *poses) if topic]


def read_views(reader: BagReader, config: CollectorConfig, assembler: ViewAssembler
               ) -> Iterator[View]:
    """Feeds a bag to an assembler; yields its views in stamp order.

    Raises:
        BagError: a message does not decode.
    """
    wanted = listened(config)
    takers: dict[str, Callable[[Any], None]] = {
        wanted[0]: assembler.add_color, config.camera_info_topic: assembler.add_camera_info,
        config.depth_topic: assembler.add_depth, config.labels_topic: assembler.add_labels,
        config.pose_topic: assembler.add_pose}
    for record in reader.records(set(wanted)):
        try:
            message = record.decode()
        except Exception as error:  # the decoder's errors are of many classes
            raise BagError(f"a message on {record.topic} does not decode: {error}") from error
        if record.topic in ("/tf", "/tf_static"):
            for transform in message.transforms:
                assembler.add_transform(transform, record.topic == "/tf_static")
        else:
            takers[record.topic](message)
        yield from assembler.poll()
    yield from assembler.flush()
