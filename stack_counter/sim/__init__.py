"""Simulated piles of parts with their true count, and recordings of them.

    scene = load_scene(path)                  # or piles.make_scene(seed, index): needs the engine
    truth = truth_of(scene)                   # count, V, gamma
    views = record(scene, views=12, seed=0)   # views with noisy depth and poses

What is named here is for `train` and `eval`; the rest is the simulator's own.
"""

from stack_counter.sim.recording import record
from stack_counter.sim.scene import Scene, load_scene
from stack_counter.sim.truth import Truth, truth_of

__all__ = ["Scene", "Truth", "load_scene", "record", "truth_of"]
