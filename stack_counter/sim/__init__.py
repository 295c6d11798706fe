# SPDX-License-Identifier: Apache-2.0
"""Simulated piles of parts with their true count, and recordings of them.

    for scene in read_scenes(folder):             # made by `stack-counter simulate`
        scene.truth                               # count, V, gamma
        views = record(scene, views=12, seed=0)   # views with noisy depth and poses

What is named here is for `train`, `eval` and `teaching`; the rest is the simulator's own.
"""

from stack_counter.sim.camera.bags import remove_parts
from stack_counter.sim.camera.depth_camera import DepthCamera
from stack_counter.sim.camera.key_picture import KeyPicture, picture_key_view
from stack_counter.sim.camera.recording import (
    CAMERA,
    record,
    record_fixed_camera,
    record_returning_camera,
    scaled_camera,
)
from stack_counter.sim.hard.kinds import HARD_KINDS, hard_kind, make_hard_scan
from stack_counter.sim.hard.piles import read_piles
from stack_counter.sim.hard.scan import HardScan
from stack_counter.sim.ideal import IdealSurface, ideal_surface, surface_grid
from stack_counter.sim.physics.collision import convex_pieces, rough_form
from stack_counter.sim.physics.container_draws import draw_deep_container
from stack_counter.sim.physics.decomposition.form import PieceForm, measure_form
from stack_counter.sim.physics.drop import simulate_pile
from stack_counter.sim.physics.plans import FRICTION, draw_plan_in_container, plan_pour
from stack_counter.sim.physics.recipes import (
    PART_PILE_PIECES,
    SCENES_PER_RIG,
    max_simulated_parts,
)
from stack_counter.sim.physics.table import lay_out_pieces
from stack_counter.sim.reconstruction import (
    reconstruct,
    reconstruct_from_above,
    reconstruct_from_pictures,
)
from stack_counter.sim.scenes.containers import RECONSTRUCTED_KIND, ContainerShape
from stack_counter.sim.scenes.ray_caster import RayCaster
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.scenes.shards import read_scenes, read_shard
from stack_counter.sim.scenes.truth import Truth
from stack_counter.sim.shapes import Shape, ShapeError, make_shape, shape_from_mesh
from stack_counter.sim.shapes.library import load_shapes, open_library, source_of
from stack_counter.sim.shapes.simplify import simplify_solid
from stack_counter.sim.view_from_above import PartsFromAbove, match_parts, parts_from_above

__all__ = [
    "CAMERA",
    "FRICTION",
    "HARD_KINDS",
    "PART_PILE_PIECES",
    "RECONSTRUCTED_KIND",
    "SCENES_PER_RIG",
    "ContainerShape",
    "DepthCamera",
    "HardScan",
    "IdealSurface",
    "KeyPicture",
    "PartsFromAbove",
    "PieceForm",
    "RayCaster",
    "Scene",
    "SceneError",
    "Shape",
    "ShapeError",
    "Truth",
    "convex_pieces",
    "draw_deep_container",
    "draw_plan_in_container",
    "hard_kind",
    "ideal_surface",
    "lay_out_pieces",
    "load_shapes",
    "make_hard_scan",
    "make_shape",
    "match_parts",
    "max_simulated_parts",
    "measure_form",
    "open_library",
    "parts_from_above",
    "picture_key_view",
    "plan_pour",
    "read_piles",
    "read_scenes",
    "read_shard",
    "reconstruct",
    "reconstruct_from_above",
    "reconstruct_from_pictures",
    "record",
    "record_fixed_camera",
    "record_returning_camera",
    "remove_parts",
    "rough_form",
    "scaled_camera",
    "shape_from_mesh",
    "simplify_solid",
    "simulate_pile",
    "source_of",
    "surface_grid",
]
