# SPDX-License-Identifier: Apache-2.0
"""What came on each topic: how often, how large, and when beside the other topics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stack_counter.views import decoding


@dataclass(eq=False)
class Stream:
    """Messages of one topic.

    Attributes:
        topic: its name.
        content: what it is for, as `RigAssembler.topic_handlers` calls it.
        stamps: of the messages, ns.
        delays: time of arrival or recording after the stamp, ns each.
        size: of all messages, bytes.
        form: size and encoding of the first message, for people; empty where it has none.
        frame: that the first message names.
    """

    topic: str
    content: str
    stamps: list[int] = field(default_factory=list)
    delays: list[int] = field(default_factory=list)
    size: int = 0
    form: str = ""
    frame: str = ""

    def add(self, message: Any, size: int, time_ns: int) -> None:
        """Notes a message of `size` bytes that came at a time, ns since 1970."""
        stamp = decoding.stamp_ns(message.header.stamp)
        if not self.stamps:
            self.form, self.frame = _form(message), message.header.frame_id.lstrip("/")
        self.stamps.append(stamp)
        self.delays.append(time_ns - stamp)
        self.size += size

    @property
    def delay_s(self) -> float:
        """Median time of arrival after the stamp, seconds; 0 without messages."""
        return float(np.median(self.delays)) * 1e-9 if self.delays else 0.0

    def describe(self, count: int, seconds: float) -> str:
        """One line: messages, rate, form, bytes a second, frame.

        Args:
            count: number of messages in all, of which those seen here may be a part.
            seconds: in which they came.
        """
        rate = count / seconds if seconds > 0 else 0.0
        each = self.size / max(len(self.stamps), 1)
        return (f"{self.content:8} {self.topic}  {count} at {rate:.3g} Hz"
                + (f", {self.form}" if self.form else "") + f", {rate * each / 1e6:.3g} MB/s"
                + (f", frame {self.frame}" if self.frame else ""))


def offsets_ns(of: Stream, beside: Stream) -> np.ndarray:
    """Stamp of the nearest message of a stream minus that of each message beside: (n,) int64 ns.

    Empty where one of the two has no messages.
    """
    stamps, others = np.sort(np.array(of.stamps, np.int64)), np.array(beside.stamps, np.int64)
    if not len(stamps) or not len(others):
        return np.zeros(0, np.int64)
    after = np.clip(np.searchsorted(stamps, others), 0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    late, early = stamps[after] - others, stamps[before] - others
    return np.where(np.abs(late) < np.abs(early), late, early)


def _form(message: Any) -> str:
    """Size and encoding of an image or calibration."""
    size = f"{message.width}x{message.height}" if hasattr(message, "width") else ""
    kind = getattr(message, "encoding", getattr(message, "format", ""))
    return " ".join(filter(None, (size, str(kind).partition(";")[0].strip())))
