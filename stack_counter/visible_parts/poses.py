# SPDX-License-Identifier: Apache-2.0
"""Where and how the best visible parts lie, by the mesh of the part.

The part is looked at from directions all around, and turned about each. Those orientations whose
heights explain the surface best are shifted, refined by ICP on the points of the surface, and
judged again; the best is kept. Poses that differ by a symmetry of the part are all right.

Source: the refinement is Segal, Haehnel and Thrun, "Generalized-ICP" (2009), as the library
`small_gicp` runs it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import small_gicp

from stack_counter import geometry
from stack_counter.types import HeightMap, Mesh, PartPose
from stack_counter.visible_parts.decoding import PartsInMap
from stack_counter.visible_parts.part_views import PartViews, make_part_views
from stack_counter.visible_parts.pose_guesses import (
    Guesses,
    SurfacePatch,
    cut_patch,
    grid_of_steps,
    guess_everywhere,
    guesses_from_poses,
    judge,
    move_to_best,
)


@dataclass(frozen=True)
class PoseSettings:
    """How a pose is searched; chosen on scenes of data/train-deep, for time as well.

    Attributes:
        least_cells: of the surface, in which a part must show.
        margin: distance to the part up to which the surface is looked at, part diameters.
        turns: about each direction, evenly spread.
        samples: cells on the part, and as many beside it, by which first guesses are judged.
        shifted: number of first guesses that are shifted.
        shift: step of that, part diameters.
        fine_shift, fine_turn_rad: steps of the motions after each refinement, part diameters and
            rad.
        refined: number of guesses that are refined.
        apart_rad: angle by which these differ at least.
        rounds: of refinement.
        gate: largest distance of two points that are taken for the same, part lengths.
        point_step: of the mesh's points, each how many is registered to.
        neighbors: number of points around one of which its covariance is estimated.
        max_iterations: of each registration.
    """

    least_cells: int = 8
    margin: float = 0.3
    turns: int = 24
    samples: int = 50
    shifted: int = 60
    shift: float = 0.05
    fine_shift: float = 0.025
    fine_turn_rad: float = 0.08
    refined: int = 5
    apart_rad: float = 0.4
    rounds: int = 2
    gate: float = 0.4
    point_step: int = 3
    neighbors: int = 10
    max_iterations: int = 15


SETTINGS = PoseSettings()


def find_poses(parts: PartsInMap, count: int, top: HeightMap, mesh: Mesh, part_length: float
               ) -> list[PartPose | None]:
    """Finds the poses of the best parts of a map: the surest of which most shows.

    Args:
        parts: as found in the maps of `top`.
        count: how many of them.
        top: the surface.
        mesh: of the part, in its own frame, metres.
        part_length: v**(1/3), metres.

    Returns:
        One for each of the parts; None for those that are not among the best, or show too little.
    """
    poses: list[PartPose | None] = [None] * len(parts.scores)
    best = np.argsort(-parts.scores * parts.shares, kind="stable")[:count]
    numbers = cv2.resize(parts.numbers.astype(np.float32), top.heights.shape[::-1],
                         interpolation=cv2.INTER_NEAREST)
    numbers[~np.isfinite(top.heights)] = -1
    for number in best.tolist():
        own = numbers == number
        if np.count_nonzero(own) >= SETTINGS.least_cells:
            poses[number] = find_pose(make_part_views(mesh), top, own, part_length)
    return poses


def find_pose(views: PartViews, top: HeightMap, own: np.ndarray, part_length: float) -> PartPose:
    """Finds the pose of one part.

    Args:
        views: of the part.
        top: the surface.
        own: (rows, cols) bool: the part shows there, and the surface is valid.
        part_length: v**(1/3), metres.
    """
    s = SETTINGS
    patch = cut_patch(top, own, s.margin * views.diameter, part_length)
    # Judge all orientations by some of the cells, and shift the best.
    few = patch.thinned(s.samples)
    guesses = judge(views, guess_everywhere(views, s.turns), few)
    guesses = guesses[np.argsort(-guesses.fit, kind="stable")[:s.shifted]]
    guesses = move_to_best(views, guesses, few,
                           grid_of_steps(s.shift * views.diameter, 2, 0.0, 0))
    # Refine those that differ; ICP says little of how a level face lies within its plane, so
    # move them there as well, as all cells say.
    fine_steps = grid_of_steps(s.fine_shift * views.diameter, 1, s.fine_turn_rad, 1)
    guesses = guesses[_choose_apart(guesses, views)]
    poses, shown_in = guesses.poses(views), guesses.view
    cloud = small_gicp.PointCloud(patch.points[patch.own].astype(float))
    small_gicp.estimate_covariances(cloud, None, s.neighbors)
    for _ in range(s.rounds):
        poses = np.stack([_register(views, view, cloud, T, s.gate * part_length)
                          for view, T in zip(shown_in, poses)])
        refined = views.at_rotations(poses[:, :3, :3])
        guesses = move_to_best(refined, guesses_from_poses(poses), patch, fine_steps)
        poses = guesses.poses(refined)
    best = int(guesses.fit.argmax())
    return PartPose(_place(poses[best], views, patch, top), float(guesses.fit[best]))


def _choose_apart(guesses: Guesses, views: PartViews) -> np.ndarray:
    """(k,) rows of the best guesses whose rotations differ from those of better ones."""
    rotations = guesses.poses(views)[:, :3, :3]
    largest_trace = 1 + 2 * np.cos(SETTINGS.apart_rad)
    chosen: list[int] = []
    for row in np.argsort(-guesses.fit, kind="stable").tolist():
        if all(np.sum(rotations[row] * rotations[other]) < largest_trace for other in chosen):
            chosen.append(row)
    return np.array(chosen[:SETTINGS.refined])


def _register(views: PartViews, view: int, cloud: small_gicp.PointCloud, T: np.ndarray,
              gate_m: float) -> np.ndarray:
    """Registers a part's surface to the points of the mesh that show in a view.

    Args:
        views: of the part.
        view: number of that near to the pose.
        cloud: points of the surface, about the patch's origin.
        T: (4, 4) pose of the mesh about its `center`, about the patch's origin.
        gate_m: largest distance of two points that are taken for the same, metres.

    Returns:
        (4, 4) refined pose.
    """
    s = SETTINGS
    target = small_gicp.PointCloud(views.shown_points(view, s.point_step))
    tree = small_gicp.KdTree(target)
    small_gicp.estimate_covariances(target, tree, s.neighbors)
    result = small_gicp.align(
        target, cloud, tree, geometry.inverse(T), max_correspondence_distance=gate_m,
        max_iterations=s.max_iterations, rotation_epsilon=1e-3, translation_epsilon=1e-6)
    return geometry.inverse(result.T_target_source)


def _place(T: np.ndarray, views: PartViews, patch: SurfacePatch, top: HeightMap) -> np.ndarray:
    """(4, 4) T_world_part of a pose of the mesh about its `center`, about the patch's origin."""
    T_map_part = geometry.pose(T[:3, :3], T[:3, 3] + patch.origin - T[:3, :3] @ views.center)
    return geometry.canonical_pose(top.T_world_map @ T_map_part)
