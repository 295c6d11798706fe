"""Simulated piles of parts with their true count, and recordings of them.

    for scene in read_scenes(folder):             # made by `stack-counter simulate`
        scene.truth                               # count, V, gamma
        views = record(scene, views=12, seed=0)   # views with noisy depth and poses

What is named here is for `train` and `eval`; the rest is the simulator's own.
"""

from stack_counter.sim.bags import picked
from stack_counter.sim.camera import DepthCamera
from stack_counter.sim.casting import Caster
from stack_counter.sim.containers import FOUND_AS
from stack_counter.sim.recording import record, watch
from stack_counter.sim.scene import Scene
from stack_counter.sim.shards import read_scenes, read_shard
from stack_counter.sim.truth import Truth

__all__ = ["FOUND_AS", "Caster", "DepthCamera", "Scene", "Truth", "picked", "read_scenes",
           "read_shard", "record", "watch"]
