"""What is learnt of one part: its piles simulated, its template scanned, its bins counted.

What is named here is for `eval`; the rest is for the command line.
"""

from stack_counter.teaching.add_part import make_order, models_of, simulate_part
from stack_counter.teaching.simulated_piles import Pile, PileScan

__all__ = ["Pile", "PileScan", "make_order", "models_of", "simulate_part"]
