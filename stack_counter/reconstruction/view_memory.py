# SPDX-License-Identifier: Apache-2.0
"""Which views a scan keeps: all of them, or in live mode the newest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from stack_counter.types import View


@dataclass(frozen=True)
class ViewMemorySettings:
    """How many views live mode remembers.

    Attributes:
        newest: views of all cameras together; measured by `stack-counter evaluate live`.
        newest_of_fixed: views of one fixed camera, which sees the same place again and again.
    """

    newest: int = 24
    newest_of_fixed: int = 2


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
        if view.fixed:
            of_camera = [v for v in self.views if v.fixed and v.camera == view.camera]
            outdated = {id(v) for v in of_camera[:-SETTINGS.newest_of_fixed]}
            self.views = [v for v in self.views if id(v) not in outdated]
        del self.views[:-SETTINGS.newest]

    def replace_all(self, views: Iterable[View]) -> None:
        """Keeps these views instead: the same ones, cut or labelled."""
        self.views = list(views)
