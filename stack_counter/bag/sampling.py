# SPDX-License-Identifier: Apache-2.0
"""Parts of a long recording that are looked at in its place: all of its images take minutes."""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import dataclass

import numpy as np

from stack_counter.bag.reader import BagReader
from stack_counter.bag.time_range import TimeRange


@dataclass(frozen=True)
class SamplingSettings:
    """How much of a recording is looked at.

    Attributes:
        images: colour images in all; chosen, a few seconds of work.
        size: of what is read, bytes; chosen, a few seconds of a common disk.
        parts: number of parts, evenly spread over the images; chosen.
    """

    images: int = 200
    size: int = 1 << 29
    parts: int = 10


SETTINGS = SamplingSettings()


def sampled_parts(reader: BagReader, color_topics: Set[str]) -> list[TimeRange]:
    """Parts of the recording, evenly spread over its colour images.

    Args:
        reader: of the bag, or of a part of it.
        color_topics: topics of colour images.

    Returns:
        Only the whole of what the reader gives, where that is little.
    """
    whole = reader.time_range
    times_ns = reader.times_ns(color_topics)
    count = sum(reader.topics.get(topic, ("", 0))[1] for topic in color_topics)
    limit = min(SETTINGS.images, math.ceil(SETTINGS.size / max(reader.size, 1) * count))
    # A chunk's time stands for all images in it.
    each = count / max(len(times_ns), 1)
    times_ns = times_ns[(times_ns >= whole.start_ns)
                        & (times_ns < (np.inf if whole.end_ns is None else whole.end_ns))]
    if len(times_ns) * each <= limit:
        return [whole]
    length = max(round(limit / each / SETTINGS.parts), 1)
    starts = np.unique(np.linspace(0, len(times_ns) - length, SETTINGS.parts).astype(int))
    ends = [int(times_ns[i + length]) if i + length < len(times_ns) else whole.end_ns
            for i in starts]
    return [TimeRange(int(times_ns[i]), end) for i, end in zip(starts, ends)]
