# SPDX-License-Identifier: Apache-2.0
"""By which topic a camera's images come: raw, or compressed beside it. No ROS."""

from __future__ import annotations

from collections.abc import Callable

AUTO, RAW, COMPRESSED = "auto", "raw", "compressed"
_SUFFIXES = ("/compressed", "/compressedDepth")  # of image_transport's topics of CompressedImage


def transport_topic(color_topic: str, transport: str) -> str:
    """Returns the topic of colour images that come by a transport; `auto`: the raw one."""
    return f"{color_topic}/compressed" if transport == COMPRESSED else color_topic


def published_transports(color_topic: str, count: Callable[[str], int]) -> list[str]:
    """Returns the transports by which colour images come, the best first.

    That is raw: such images are as the camera took them, and drivers of image_transport, which
    offer both, compress them only while somebody subscribes to that.

    Args:
        color_topic: name of the raw topic.
        count: number of publishers, or of recorded messages, of a topic.
    """
    return [transport for transport in (RAW, COMPRESSED)
            if count(transport_topic(color_topic, transport))]


def color_topics(color_topic: str, setting: str) -> list[str]:
    """Returns the topics on which colour images may come, the best first.

    Args:
        color_topic: name of the raw topic.
        setting: `color_transport`.
    """
    transports = (RAW, COMPRESSED) if setting == AUTO else (setting,)
    return [transport_topic(color_topic, transport) for transport in transports]


def depth_topics(depth_topic: str) -> list[str]:
    """Returns the topics on which depth of a configured name may come, the best first."""
    if not depth_topic or is_compressed(depth_topic):
        return [depth_topic]
    return [depth_topic, *(f"{depth_topic}{suffix}" for suffix in reversed(_SUFFIXES))]


def is_compressed(topic: str) -> bool:
    """Tells whether a topic of images is, by its name, one of `CompressedImage`."""
    return topic.endswith(_SUFFIXES)


def without_transport(topic: str) -> str:
    """Returns the name of the raw topic beside which a compressed one lies."""
    return topic.rpartition("/")[0] if is_compressed(topic) else topic


def wrong_transport_line(color_topic: str, setting: str, count: Callable[[str], int]) -> str:
    """Says that colour images come by the transport that is not set; "" if that is not so.

    Args:
        color_topic: name of the raw topic.
        setting: `color_transport`.
        count: number of publishers of a topic.
    """
    published = published_transports(color_topic, count)
    if setting == AUTO or not published or setting in published:
        return ""
    topic = transport_topic(color_topic, published[0])
    number = count(topic)
    return (f"{topic} has {number} publisher{'s' * (number > 1)}: set color_transport: "
            f"{published[0]} (or auto)")
