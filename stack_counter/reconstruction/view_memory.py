# SPDX-License-Identifier: Apache-2.0
"""Which views a scan keeps: all of them, or in live mode the newest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from stack_counter import geometry
from stack_counter.types import View


@dataclass(frozen=True)
class ViewMemorySettings:
    """How many views live mode remembers.

    Attributes:
        newest: views of all cameras together; measured by `stack-counter evaluate live`.
        newest_of_place: views of one camera from one place, which show the same again and again;
            measured by the same.
        same_place_m, same_place_rad: poses that differ by no more, in metres and radians, are one
            place: what the collector takes for no motion by default.
    """

    newest: int = 24
    newest_of_place: int = 2
    same_place_m: float = 0.005
    same_place_rad: float = 0.02


SETTINGS = ViewMemorySettings()


class ViewMemory:
    """The views of one scan. Live mode never ends: old views, which show what is gone, go.

    Attributes:
        views: those kept, in the order in which they came.
    """

    def __init__(self, live: bool):
        """`live`: only the newest views are kept."""
        self._live = live
        self.views: list[View] = []

    def add_view(self, view: View) -> None:
        """Keeps one more view; in live mode older ones may go for it."""
        self.views.append(view)
        if not self._live:
            return
        of_place = [v for v in self.views if _are_from_same_place(v, view)]
        outdated = {id(v) for v in of_place[:-SETTINGS.newest_of_place]}
        self.views = [v for v in self.views if id(v) not in outdated]
        del self.views[:-SETTINGS.newest]

    def replace_all(self, views: Iterable[View]) -> None:
        """Keeps these views instead: the same ones, cut or labelled."""
        self.views = list(views)


def _are_from_same_place(a: View, b: View) -> bool:
    """Tells whether two views are of a fixed camera, or of one that stands or was brought back."""
    if a.camera != b.camera:
        return False
    if a.fixed and b.fixed:
        return True
    distance, angle = geometry.pose_change(a.T_world_camera, b.T_world_camera)
    return distance <= SETTINGS.same_place_m and angle <= SETTINGS.same_place_rad
