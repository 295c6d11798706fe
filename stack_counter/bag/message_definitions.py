# SPDX-License-Identifier: Apache-2.0
"""Texts that define message types (`ros2msg`), as recordings and viewers need them."""

from __future__ import annotations

from functools import cache

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from stack_counter.errors import BagError
from stack_counter.files import share_folders

_OUR_PACKAGE = "stack_counter_msgs"


def message_definition(kind: str) -> str:
    """Returns the definition of a type, and behind it those of all types that it is made of.

    Args:
        kind: name of the type, e.g. `sensor_msgs/msg/Image`: one of ROS 2 or of this package.

    Raises:
        BagError: no such type is known.
    """
    store = known_types()
    if kind not in store.types:
        raise BagError(f"unknown message type '{kind}'; expected one of ROS 2 Jazzy or of "
                       f"{_OUR_PACKAGE}")
    return store.generate_msgdef(kind, ros_version=2)[0]


@cache
def known_types() -> Typestore:
    """Returns the types of ROS 2 and, where its package is installed, of this package's own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for folder in share_folders(_OUR_PACKAGE):
        for path in sorted(folder.glob("msg/*.msg")):
            kind = f"{_OUR_PACKAGE}/msg/{path.stem}"
            if kind not in store.types:  # the first folder counts, as in ROS
                store.register(get_types_from_msg(path.read_text(encoding="utf-8"), kind))
    return store
