# SPDX-License-Identifier: Apache-2.0
"""Open3D without what its import loads for plots in a browser.

`import open3d` imports dash, and dash IPython: two thirds of its time, 1.2 of 1.7 CPU seconds, for
three functions that nothing here calls. They stay as they are for others: the first call of one
loads what it needs.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

_PLOTS = "open3d.visualization.draw_plotly"
_FUNCTIONS = ("get_plotly_fig", "draw_plotly", "draw_plotly_server")


def _deferred(name: str) -> Callable[..., Any]:
    """Returns a function that loads Open3D's own of that name, and calls it."""
    def call(*arguments: Any, **options: Any) -> Any:
        if sys.modules[_PLOTS] is _stand_in:
            del sys.modules[_PLOTS]
        plots = importlib.import_module(_PLOTS)
        for function in _FUNCTIONS:  # one has the name of the module, which now stands there
            setattr(sys.modules["open3d.visualization"], function, getattr(plots, function))
        return getattr(plots, name)(*arguments, **options)

    return call


_stand_in = ModuleType(_PLOTS)
for _name in _FUNCTIONS:
    setattr(_stand_in, _name, _deferred(_name))
sys.modules.setdefault(_PLOTS, _stand_in)  # where Open3D is loaded already, its own stays

import open3d as o3d  # noqa: E402
import open3d.core as o3c  # noqa: E402

__all__ = ["o3c", "o3d"]
