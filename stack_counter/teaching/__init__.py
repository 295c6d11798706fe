# SPDX-License-Identifier: Apache-2.0
"""What is learnt of one part or container: piles simulated, an empty container measured.

What is named here is for `eval`; the rest is for the command line.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stack_counter.teaching.add_part import (
        fit_part_models,
        make_pile_request,
        simulate_part_piles,
    )
    from stack_counter.teaching.simulated_piles import Pile, PileScan

__all__ = ["Pile", "PileScan", "make_pile_request", "fit_part_models", "simulate_part_piles"]
_SIMULATED = ("Pile", "PileScan")


def __getattr__(name: str) -> Any:
    """Loads a module with its first use: a container is taught without the simulator."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "simulated_piles" if name in _SIMULATED else "add_part"
    return getattr(import_module(f"{__name__}.{module}"), name)
