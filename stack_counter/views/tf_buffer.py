# SPDX-License-Identifier: Apache-2.0
"""Poses at a stamp from recorded or live transforms (TF).

This is not tf2_ros, even where that exists: tf2_ros interpolates across gaps of any width, here
only what stands still does without samples, and replay without ROS must find the very same poses
as the nodes.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass, field

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ViewError


@dataclass(frozen=True)
class TransformBufferSettings:
    """How samples of transforms are kept; chosen.

    Attributes:
        clock_jump_ns: a sample older than the newest by more than this is no late one: the clock
            was set back.
        kept_ns: samples older than the newest by more than this are forgotten.
        kept_samples: of one frame, at most: one a millisecond for as long, and more.
        frames: with parents, at most; a cell with several robots has some hundred.
        named_parents: of one frame that has several, at most.
        still_m, still_rad: two samples that differ by no more, in metres and radians, are of a
            joint at rest: ten times the steps of a usual encoder, a fifth of an arm's noise.
    """

    clock_jump_ns: int = 10**9
    kept_ns: int = 60 * 10**9
    kept_samples: int = 100_000
    frames: int = 10_000
    named_parents: int = 5
    still_m: float = 1e-4
    still_rad: float = 1e-4


SETTINGS = TransformBufferSettings()


@dataclass(eq=False)
class TransformSamples:
    """Samples of one child frame in its parent, in stamp order.

    Attributes:
        parent: name of the parent frame.
        static: the transform does not change.
        stamps: stamps, ns.
        poses: (4, 4) T_parent_child at these stamps.
        behind: stamp of the last sample if it was much older than the newest, else -1.
    """

    parent: str
    static: bool
    stamps: list[int] = field(default_factory=list)
    poses: list[np.ndarray] = field(default_factory=list)
    behind: int = -1

    def add(self, stamp_ns: int, T: np.ndarray) -> None:
        """Adds a sample, or replaces the one of the same stamp."""
        behind, self.behind = self.behind, -1
        if self.stamps and self.stamps[-1] - stamp_ns > SETTINGS.clock_jump_ns:
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
        old = max(bisect.bisect_left(self.stamps, self.stamps[-1] - SETTINGS.kept_ns),
                  len(self.stamps) - SETTINGS.kept_samples)
        if old:
            del self.stamps[:old], self.poses[:old]


class TransformBuffer:
    """A tree of frames, in which every frame has one parent, with samples over time."""

    def __init__(self, max_gap_s: float):
        """Makes an empty buffer.

        Args:
            max_gap_s: widest gap between two samples that is interpolated in, seconds.
        """
        self._max_gap_ns = round(max_gap_s * 1e9)
        self._edges: dict[str, TransformSamples] = {}
        self._parents: dict[str, set[str]] = {}  # all that a frame has had

    def add_transform(self, stamp_ns: int, parent: str, child: str, T_parent_child: np.ndarray,
                      static: bool = False) -> None:
        """Adds a sample, in any order of stamps; a static one replaces the last.

        Raises:
            ViewError: reason `no_tf`: the frame is new, and there are too many already.
        """
        edge = self._edges.get(child)
        if edge is None and len(self._edges) >= SETTINGS.frames:
            raise ViewError("no_tf", f"frame '{child}' beside {len(self._edges)} others; expected "
                                     f"at most {SETTINGS.frames}: see who publishes /tf")
        if edge is None or edge.parent != parent or edge.static != static or static:
            edge = self._edges[child] = TransformSamples(parent, static)
            if len(parents := self._parents.setdefault(child, set())) < SETTINGS.named_parents:
                parents.add(parent)
        edge.add(stamp_ns, T_parent_child)

    def is_ready(self, target: str, source: str, stamp_ns: int) -> bool:
        """Tells whether later samples cannot change what `lookup` returns for this stamp."""
        try:
            up, down = self._paths_to_common_ancestor(target, source)
        except ViewError as error:
            return error.reason == "tf_loop"
        return all(e.static or e.stamps[-1] >= stamp_ns
                   for e in (self._edges[name] for name in up + down))

    def lookup(self, target: str, source: str, stamp_ns: int) -> tuple[np.ndarray, bool]:
        """Returns T_target_source (4, 4) at a stamp, and whether all of it is static.

        Raises:
            ViewError: reason `no_tf` (frames not connected, or no samples close enough around the
                stamp) or `tf_loop`.
        """
        up, down = self._paths_to_common_ancestor(target, source)
        T = np.eye(4)
        for name in up:  # from the source towards the root
            T = self._interpolate_at(name, stamp_ns) @ T
        T_root_target = np.eye(4)
        for name in down:
            T_root_target = self._interpolate_at(name, stamp_ns) @ T_root_target
        return (geometry.inverse(T_root_target) @ T,
                all(self._edges[name].static for name in up + down))

    def _paths_to_common_ancestor(self, target: str, source: str) -> tuple[list[str], list[str]]:
        """Returns the frames from source and from target up to their first common ancestor.

        Raises:
            ViewError: reason `no_tf` or `tf_loop`: the frames are not connected in a tree.
        """
        ups, downs = self._ancestors(source), self._ancestors(target)
        common = next((name for name in ups if name in downs), None)
        if common is None:
            raise ViewError("no_tf", f"no transforms connect '{target}' and '{source}'; expected "
                                     f"a chain of them: {self._advice(target, source, ups[-1])}")
        return ups[:ups.index(common)], downs[:downs.index(common)]

    def _advice(self, target: str, source: str, root: str) -> str:
        """Says which frames there are, and what would connect the two."""
        frames = set(self._edges) | {edge.parent for edge in self._edges.values()}
        known = f"known frames: {sorted(frames) or 'none'}"
        if not source:
            return "neither images nor calibration name a frame: have the driver set their " \
                   f"frame_id; {known}"
        if source not in frames:
            return f"no transform names '{source}': publish one (robot driver, hand-eye " \
                   f"calibration) and record /tf and /tf_static; {known}"
        return f"'{source}' hangs below '{root}': set world_frame to '{root}' if its z axis " \
               f"points up, or publish a transform between it and '{target}'; {known}"

    def _ancestors(self, name: str) -> list[str]:
        chain = [name]
        while chain[-1] in self._edges:
            parent = self._edges[chain[-1]].parent
            if parent in chain:
                raise ViewError("tf_loop", f"frames {' -> '.join(chain + [parent])} form a loop; "
                                           "expected a tree")
            chain.append(parent)
        return chain

    def _interpolate_at(self, name: str, stamp_ns: int) -> np.ndarray:
        edge = self._edges[name]
        if edge.static:
            return edge.poses[-1]
        i = bisect.bisect_left(edge.stamps, stamp_ns)
        if i < len(edge.stamps) and edge.stamps[i] == stamp_ns:
            return edge.poses[i]
        if i == 0 or i == len(edge.stamps) or not self._spans_gap(edge, i):
            raise self._gap_error(name, stamp_ns)
        gap_ns = edge.stamps[i] - edge.stamps[i - 1]
        return geometry.interpolate_pose(edge.poses[i - 1], edge.poses[i],
                                         (stamp_ns - edge.stamps[i - 1]) / gap_ns)

    def _spans_gap(self, edge: TransformSamples, i: int) -> bool:
        """Tells whether poses between sample i - 1 and sample i follow from the two."""
        return edge.stamps[i] - edge.stamps[i - 1] <= self._max_gap_ns \
            or is_still(edge.poses[i - 1], edge.poses[i])

    def _gap_error(self, name: str, stamp_ns: int) -> ViewError:
        """The error of an image without samples close enough around it."""
        edge = self._edges[name]
        i = bisect.bisect_left(edge.stamps, stamp_ns)
        before = f"{(stamp_ns - edge.stamps[i - 1]) / 1e6:.1f} ms" if i else "nothing"
        after = f"{(edge.stamps[i] - stamp_ns) / 1e6:.1f} ms" if i < len(edge.stamps) \
            else "nothing"
        others = sorted(self._parents[name] - {edge.parent})
        advice = f": it is also published below {others}; let it have one parent" if others \
            else ": publish what never changes on /tf_static" if len(edge.stamps) == 1 else ""
        return ViewError("no_tf", f"'{name}' in '{edge.parent}' has {before} before and {after} "
                                  f"after the image; expected samples at most "
                                  f"{self._max_gap_ns / 1e6:.0f} ms apart (tf_max_gap_s), or "
                                  f"equal ones{advice}")


def is_still(T_a: np.ndarray, T_b: np.ndarray) -> bool:
    """Tells whether two (4, 4) poses are equal but for an encoder's last digits."""
    distance, angle = geometry.pose_change(T_a, T_b)
    return distance <= SETTINGS.still_m and angle <= SETTINGS.still_rad
