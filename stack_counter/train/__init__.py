"""Fits what says gamma on simulated piles.

What is named here is for `eval`; the rest is training's own.
"""

from stack_counter.train.fused import reconstruct
from stack_counter.train.heights import cast

__all__ = ["cast", "reconstruct"]
