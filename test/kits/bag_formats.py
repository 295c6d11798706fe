# SPDX-License-Identifier: Apache-2.0
"""One recording in every form that recorders write, made by rosbags and the mcap library."""

from __future__ import annotations

import shutil

import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
_FOREVER = QosTime(9223372036, 854775807)
MCAP, SQLITE = StoragePlugin.MCAP, StoragePlugin.SQLITE3


def messages_of(path):
    """(log time ns, topic, type, CDR) of a rosbag2 folder, by time; read by rosbags."""
    with Reader(path) as reader:
        return [(t, c.topic, c.msgtype, bytes(data)) for c, t, data in reader.messages()]


def rosbag2(path, messages, plugin=MCAP, mode=None):
    """A rosbag2 folder; `mode`: compressed by FILE or by MESSAGE."""
    writer = Writer(path, version=9, storage_plugin=plugin)
    if mode:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for t, topic, kind, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, kind, typestore=STORE, offered_qos_profiles=_qos(topic))
            writer.write(connections[topic], t, data)
    return path


def _qos(topic):
    """Profiles of a publisher: static transforms are latched."""
    durability = QosDurability.TRANSIENT_LOCAL if topic == "/tf_static" else QosDurability.VOLATILE
    return [Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, durability, _FOREVER, _FOREVER,
                QosLiveliness.AUTOMATIC, _FOREVER, False)]


def ros1(path, messages, compression=None):
    """A .bag of ROS 1."""
    writer = Ros1Writer(path)
    if compression:
        writer.set_compression(compression)
    with writer:
        connections = {}
        for t, topic, kind, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, kind, typestore=STORE, latching=int(topic == "/tf_static"))
            writer.write(connections[topic], t, STORE.cdr_to_ros1(data, kind))
    return path


def bare_mcap(path, messages, definitions=False, encoding="cdr", **options):
    """An .mcap file; without `definitions` its types have names alone."""
    with open(path, "wb") as file:
        writer = McapWriter(file, **{"compression": CompressionType.ZSTD, **options})
        writer.start("ros2", "test")
        channels = {}
        for t, topic, kind, data in messages:
            if topic not in channels:
                text = STORE.generate_msgdef(kind, ros_version=2)[0] if definitions else ""
                schema = writer.register_schema(kind, "ros2msg" if text else "", text.encode())
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], t, data, t)
        writer.finish()
    return path


def packed(path, out):
    """A file compressed by zstd."""
    out.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
    return out


def bare(folder, suffix, out):
    """The one file of a folder, without its metadata.yaml."""
    source, = folder.glob(f"*{suffix}")
    return shutil.copy(source, out)


def split(folder, messages, parts=3, plugin=MCAP):
    """A folder of several files, as a recorder leaves it that is killed."""
    folder.mkdir()
    size = -(-len(messages) // parts)
    for i in range(parts):
        rosbag2(folder / "part", messages[i * size:(i + 1) * size], plugin)
        source = next(p for p in (folder / "part").iterdir() if p.suffix != ".yaml")
        source.rename(folder / f"rosbag2_{i}{source.suffix}")
        shutil.rmtree(folder / "part")
    return folder


# By name: what makes the bag in a new folder, and returns the path that a user names.
FORMATS = {
    "sqlite3": lambda f, m: rosbag2(f / "bag", m, SQLITE),
    "bare db3": lambda f, m: bare(rosbag2(f / "bag", m, SQLITE), ".db3", f / "a.db3"),
    "mcap by file": lambda f, m: rosbag2(f / "bag", m, MCAP, CompressionMode.FILE),
    "db3 by file": lambda f, m: rosbag2(f / "bag", m, SQLITE, CompressionMode.FILE),
    "bare mcap.zstd": lambda f, m: packed(bare_mcap(f / "a.mcap", m, True), f / "b.mcap.zstd"),
    "bare db3.zstd": lambda f, m: bare(rosbag2(f / "bag", m, SQLITE, CompressionMode.FILE),
                                       ".zstd", f / "a.db3.zstd"),
    "mcap by message": lambda f, m: rosbag2(f / "bag", m, MCAP, CompressionMode.MESSAGE),
    "db3 by message": lambda f, m: rosbag2(f / "bag", m, SQLITE, CompressionMode.MESSAGE),
    "bare db3 by message": lambda f, m: bare(
        rosbag2(f / "bag", m, SQLITE, CompressionMode.MESSAGE), ".db3", f / "a.db3"),
    "split mcap": lambda f, m: split(f / "bag", m),
    "split db3": lambda f, m: split(f / "bag", m, plugin=SQLITE),
    "empty schemas": lambda f, m: bare_mcap(f / "a.mcap", m),
    "no chunks": lambda f, m: bare_mcap(f / "a.mcap", m, True, use_chunking=False),
    "ros1": lambda f, m: ros1(f / "a.bag", m),
    "ros1 lz4": lambda f, m: ros1(f / "a.bag", m, Ros1Writer.CompressionFormat.LZ4),
    "ros1 bz2": lambda f, m: ros1(f / "a.bag", m, Ros1Writer.CompressionFormat.BZ2),
}
