"""Fits what says gamma on simulated piles.

What is named here is for `eval` and `part`; the rest is training's own.
"""

from stack_counter.train.data.fused import reconstruct, reconstruct_from_above
from stack_counter.train.data.heights import ideal_surface

__all__ = ["ideal_surface", "reconstruct", "reconstruct_from_above"]
