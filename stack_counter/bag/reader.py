"""Reads recorded bags: rosbag2 folders and bare .mcap files, whole or cut short; no ROS needed."""

from __future__ import annotations

import heapq
import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from mcap_ros2.decoder import DecoderFactory

from stack_counter.bag.mcap_file import McapFile, RawMessage
from stack_counter.bag.record_names import FACTS, finished
from stack_counter.config import CollectorConfig
from stack_counter.errors import BagError
from stack_counter.types import View
from stack_counter.views.rig import Rig, RigAssembler

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
        topics: type name and number of messages by topic, of topics that have messages.
        facts: what the collector has noted with the recording of a scan; else empty.
    """

    def __init__(self, path: Path):
        """Finds the files and what is in them.

        Raises:
            FileNotFoundError: no such path.
            BagError: not an mcap file, or a folder without one.
        """
        self._files = [McapFile(p) for p in _paths(path)]
        self._factories = [DecoderFactory() for _ in self._files]  # numbers hold within a file
        types: dict[str, str] = {}
        counts: Counter[str] = Counter()
        for file in self._files:
            for channel_id, count in file.counts.items():
                channel = file.channels.get(channel_id)
                schema = file.schemas.get(channel.schema_id) if channel else None
                if channel and schema and count:
                    types[channel.topic] = schema.name
                    counts[channel.topic] += count
        self.topics = {topic: (types[topic], counts[topic]) for topic in sorted(types)}
        self.facts = {key: value for file in self._files
                      for key, value in file.metadata.get(FACTS, {}).items()}

    @property
    def overrun(self) -> set[tuple[str, int]]:
        """Camera and stamp of the views that the recorded scan had no time for and left out."""
        return {(camera, stamp) for camera, stamp in json.loads(self.facts.get("overrun", "[]"))}

    @property
    def truncated(self) -> bool:
        """A file ends early or is damaged, or its recording ended before the scan."""
        return any(file.truncated for file in self._files) \
            or self.facts.get("ended", "").startswith("cut")

    def records(self, topics: set[str]) -> Iterator[Record]:
        """The messages of these topics in log-time order; of equal times, in file order."""
        blocks = sorted((block.start_ns, number, block.offset, block)
                        for number, file in enumerate(self._files) for block in file.blocks)
        heap: list[tuple[int, int, int, int, RawMessage]] = []
        upcoming = 0
        while heap or upcoming < len(blocks):
            while upcoming < len(blocks) and (not heap or blocks[upcoming][0] <= heap[0][0]):
                _, number, offset, block = blocks[upcoming]
                upcoming += 1
                file = self._files[number]
                for place, message in enumerate(file.load(block)):
                    channel = file.channels.get(message.channel_id)
                    if channel and channel.topic in topics:
                        heapq.heappush(heap, (message.log_time_ns, number, offset, place, message))
            if heap:
                _, number, _, _, message = heapq.heappop(heap)
                yield self._record(number, message)

    def _record(self, number: int, message: RawMessage) -> Record:
        file = self._files[number]
        channel = file.channels[message.channel_id]
        schema = file.schemas.get(channel.schema_id)
        decoder = self._factories[number].decoder_for(channel.message_encoding, schema)
        if decoder is None:
            raise BagError(f"{channel.topic} is encoded as '{channel.message_encoding}', its type "
                           f"as '{schema.encoding if schema else ''}'; expected cdr, ros2msg")
        return Record(channel.topic, message.log_time_ns, message.data,
                      partial(decoder, message.data))


def _paths(path: Path) -> list[Path]:
    """The .mcap files of a bag."""
    if not path.exists():
        raise FileNotFoundError(f"no bag {path}; expected a rosbag2 folder or .mcap file")
    if path.is_file():
        return [path]
    paths = sorted(path.glob("*.mcap"))  # a recorder that was killed leaves no metadata.yaml
    if not paths:
        raise BagError(f"no .mcap file in {path}; it holds "
                       f"{sorted(p.name for p in path.iterdir())[:8]}")
    if len(scans := finished(path)) > 1:
        raise BagError(f"{path} holds the recordings of {len(scans)} scans; expected one: name "
                       f"its file, e.g. {scans[-1]}")
    try:
        metadata = yaml.safe_load((path / "metadata.yaml").read_text())
        told = metadata["rosbag2_bagfile_information"]
        names, compression = told["relative_file_paths"], told.get("compression_mode")
    except FileNotFoundError:
        return paths
    except (yaml.YAMLError, UnicodeDecodeError, TypeError, KeyError, AttributeError) as error:
        raise BagError(f"{path / 'metadata.yaml'} is not a rosbag2 metadata file: "
                       f"{str(error).splitlines()[0]}") from error
    if str(compression or "none").lower() not in ("none", "storage"):
        raise BagError(f"{path} is compressed by '{compression}'; expected none, or chunks "
                       "compressed within the .mcap file")
    missing = [name for name in names if not (path / name).is_file()]
    if missing:
        raise BagError(f"{path} lacks {', '.join(missing)}, named in its metadata.yaml")
    return paths


def fit_config(config: CollectorConfig, topics: dict[str, tuple[str, int]]) -> CollectorConfig:
    """The settings of one camera with topics and transports that the bag has; a replay is not
    recorded.

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
        labels_topic=labels if labels in topics else "", record_folder="")


def fit_rig(rig: Rig, topics: dict[str, tuple[str, int]]) -> Rig:
    """One camera with topics and transports that the bag has; a rig file's as they are.

    Raises:
        BagError: no colour images of any camera.
    """
    if len(rig.cameras) == 1:
        camera = rig.cameras[0]
        return replace(rig, cameras=(replace(camera, config=fit_config(camera.config, topics)),))
    wanted = RigAssembler(rig).color_topics()
    if not set(wanted) & set(topics):
        raise BagError(f"no images on {', '.join(wanted)}; the bag has "
                       f"{', '.join(topics) or 'no topics'}")
    return rig


def listened(assembler: RigAssembler) -> list[str]:
    """The topics that a collector of these cameras listens to."""
    return [*assembler.takers(), *(("/tf", "/tf_static") if assembler.needs_tf else ())]


def read_views(reader: BagReader, assembler: RigAssembler) -> Iterator[tuple[str, View]]:
    """Feeds a bag to the cameras' assemblers; yields camera names and views, of each camera in
    stamp order.

    Raises:
        BagError: a message does not decode.
    """
    takers = assembler.takers()
    for record in reader.records(set(listened(assembler))):
        try:
            message = record.decode()
        except Exception as error:  # the decoder's errors are of many classes
            raise BagError(f"a message on {record.topic} does not decode: {error}") from error
        if record.topic in ("/tf", "/tf_static"):
            for transform in message.transforms:
                assembler.add_transform(transform, record.topic == "/tf_static")
        for _, take in takers.get(record.topic, ()):
            take(message)
        yield from assembler.poll()
    yield from assembler.flush()
