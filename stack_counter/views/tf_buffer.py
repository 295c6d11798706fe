"""Poses at a stamp from recorded or live transforms (TF).

Not tf2_ros, even where it exists: it interpolates across gaps of any width, and replay without
ROS must find the very same poses as the nodes.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass, field

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ViewError

_JUMP_NS = 10**9  # back by more than this is no sample that is late
KEEP_NS = 60 * 10**9  # samples older than this behind the newest are forgotten


@dataclass
class _Edge:
    """Samples of one child frame in its parent, in stamp order."""

    parent: str
    static: bool
    stamps: list[int] = field(default_factory=list)
    poses: list[np.ndarray] = field(default_factory=list)
    behind: int = -1  # stamp of the last sample, if it was much older than the newest

    def add(self, stamp_ns: int, T: np.ndarray) -> None:
        behind, self.behind = self.behind, -1
        if self.stamps and self.stamps[-1] - stamp_ns > _JUMP_NS:
            self.behind = stamp_ns
            if -1 < behind < stamp_ns:  # two in a row: the clock was set back
                later = bisect.bisect_right(self.stamps, stamp_ns)
                del self.stamps[later:], self.poses[later:]
        i = bisect.bisect_left(self.stamps, stamp_ns)
        if i < len(self.stamps) and self.stamps[i] == stamp_ns:
            self.poses[i] = T
            return
        self.stamps.insert(i, stamp_ns)
        self.poses.insert(i, T)
        old = bisect.bisect_left(self.stamps, self.stamps[-1] - KEEP_NS)
        if old:
            del self.stamps[:old], self.poses[:old]


class TransformBuffer:
    """A tree of frames; every frame has one parent."""

    def __init__(self, max_gap_s: float):
        """`max_gap_s`: widest gap between two samples that is interpolated in, seconds."""
        self._max_gap_ns = round(max_gap_s * 1e9)
        self._edges: dict[str, _Edge] = {}

    def add_transform(self, stamp_ns: int, parent: str, child: str, T_parent_child: np.ndarray,
                      static: bool = False) -> None:
        """Adds a sample, in any order of stamps; a static one replaces the last."""
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent or edge.static != static or static:
            edge = self._edges[child] = _Edge(parent, static)
        edge.add(stamp_ns, T_parent_child)

    def ready(self, target: str, source: str, stamp_ns: int) -> bool:
        """Whether waiting longer cannot change what `lookup` says."""
        try:
            up, down = self._chains(target, source)
        except ViewError as error:
            return error.reason == "tf_loop"
        return all(e.static or e.stamps[-1] >= stamp_ns
                   for e in (self._edges[name] for name in up + down))

    def lookup(self, target: str, source: str, stamp_ns: int) -> tuple[np.ndarray, bool]:
        """T_target_source (4, 4) at a stamp, and whether all of it is static.

        Raises:
            ViewError: reason `no_tf` (frames not connected, or no samples close enough around the
                stamp) or `tf_loop`.
        """
        up, down = self._chains(target, source)
        T = np.eye(4)
        for name in up:  # from the source towards the root
            T = self._at(name, stamp_ns) @ T
        T_root_target = np.eye(4)
        for name in down:
            T_root_target = self._at(name, stamp_ns) @ T_root_target
        return (geometry.inverse(T_root_target) @ T,
                all(self._edges[name].static for name in up + down))

    def _chains(self, target: str, source: str) -> tuple[list[str], list[str]]:
        """Frames from source and from target up to their first common ancestor, without it."""
        ups, downs = self._ancestors(source), self._ancestors(target)
        common = next((name for name in ups if name in downs), None)
        if common is None:
            raise ViewError("no_tf", f"no transforms connect '{target}' and '{source}'; known "
                                     f"frames: {sorted(self._edges) or 'none'}")
        return ups[:ups.index(common)], downs[:downs.index(common)]

    def _ancestors(self, name: str) -> list[str]:
        chain = [name]
        while chain[-1] in self._edges:
            parent = self._edges[chain[-1]].parent
            if parent in chain:
                raise ViewError("tf_loop", f"frames {' -> '.join(chain + [parent])} form a loop; "
                                           "expected a tree")
            chain.append(parent)
        return chain

    def _at(self, name: str, stamp_ns: int) -> np.ndarray:
        edge = self._edges[name]
        if edge.static:
            return edge.poses[-1]
        i = bisect.bisect_left(edge.stamps, stamp_ns)
        if i < len(edge.stamps) and edge.stamps[i] == stamp_ns:
            return edge.poses[i]
        before = stamp_ns - edge.stamps[i - 1] if i else None
        after = edge.stamps[i] - stamp_ns if i < len(edge.stamps) else None
        if before is None or after is None or before + after > self._max_gap_ns:
            sides = [f"{x / 1e6:.1f} ms" if x is not None else "nothing" for x in (before, after)]
            raise ViewError("no_tf", f"'{name}' in '{edge.parent}' has {sides[0]} before and "
                                     f"{sides[1]} after the image; expected samples at most "
                                     f"{self._max_gap_ns / 1e6:.0f} ms apart")
        return geometry.interpolate(edge.poses[i - 1], edge.poses[i], before / (before + after))
