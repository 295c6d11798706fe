"""Simulated piles of parts with their true count, and recordings of them.

    for scene in read_scenes(folder):             # made by `stack-counter simulate`
        scene.truth                               # count, V, gamma
        views = record(scene, views=12, seed=0)   # views with noisy depth and poses

What is named here is for `train`, `eval` and `part`; the rest is the simulator's own.
"""

from stack_counter.sim.camera.bags import remove_parts
from stack_counter.sim.camera.depth_camera import DepthCamera
from stack_counter.sim.camera.recording import record, record_fixed_camera
from stack_counter.sim.physics.drop import simulate_pile
from stack_counter.sim.physics.plans import FRICTION, deep_container, pile_in
from stack_counter.sim.physics.recipes import SCENES_PER_RIG, most_parts
from stack_counter.sim.physics.table import lay_out_pieces
from stack_counter.sim.scenes.containers import FOUND_AS, ContainerShape
from stack_counter.sim.scenes.ray_caster import Caster
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.scenes.shards import read_scenes, read_shard
from stack_counter.sim.scenes.truth import Truth
from stack_counter.sim.shapes import Shape, ShapeError, make_shape, shape_from_mesh
from stack_counter.sim.shapes.library import load_shapes

__all__ = [
    "FOUND_AS",
    "FRICTION",
    "SCENES_PER_RIG",
    "Caster",
    "ContainerShape",
    "DepthCamera",
    "Scene",
    "SceneError",
    "Shape",
    "ShapeError",
    "Truth",
    "deep_container",
    "simulate_pile",
    "load_shapes",
    "make_shape",
    "most_parts",
    "remove_parts",
    "pile_in",
    "read_scenes",
    "read_shard",
    "record",
    "shape_from_mesh",
    "lay_out_pieces",
    "record_fixed_camera",
]
