# SPDX-License-Identifier: Apache-2.0
"""The tree of frames that transforms make: its roots, and what hangs below them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stack_counter.views import decoding


@dataclass(eq=False)
class TfTree:
    """Frames by what was said of them.

    Attributes:
        parents: parent of each child frame.
        stamps: of the transforms that move, ns, by child frame.
        delays: time of arrival or recording of these after their stamps, ns.
    """

    parents: dict[str, str] = field(default_factory=dict)
    stamps: dict[str, list[int]] = field(default_factory=dict)
    delays: list[int] = field(default_factory=list)

    def add(self, transform: Any, static: bool, time_ns: int) -> None:
        """Takes a `TransformStamped` that came at a time, ns since 1970."""
        child = transform.child_frame_id.lstrip("/")
        self.parents[child] = transform.header.frame_id.lstrip("/")
        if not static:
            stamp = decoding.stamp_ns(transform.header.stamp)
            self.stamps.setdefault(child, []).append(stamp)
            self.delays.append(time_ns - stamp)

    @property
    def delay_s(self) -> float:
        """Median time of arrival after the stamp, seconds; 0 without moving transforms."""
        return float(np.median(self.delays)) * 1e-9 if self.delays else 0.0

    @property
    def roots(self) -> list[str]:
        """Frames that have no parent."""
        return sorted(set(self.parents.values()) - set(self.parents))

    def chain(self, frame: str) -> list[str]:
        """Frames from a root down to this one; the frame alone where no transform names it."""
        chain = [frame]
        while chain[0] in self.parents and self.parents[chain[0]] not in chain:
            chain.insert(0, self.parents[chain[0]])
        return chain

    def describe(self, frame: str) -> str:
        """One line: roots, and the way down to a camera's frame."""
        if not self.parents:
            return "tf       none"
        roots = ", ".join(self.roots) or "none, a loop"
        return (f"tf       {len(self.parents) + len(self.roots)} frames, "
                f"root{'s' * (len(self.roots) != 1)} {roots}; "
                f"{' > '.join(self.chain(frame)) if frame else 'no camera'}")
