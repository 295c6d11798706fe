# SPDX-License-Identifier: Apache-2.0
"""Hard because of the bins: side by side, raised, sunk, or given with other sizes than theirs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.sim.camera.recording import arc_poses
from stack_counter.sim.hard.piles import outer_size, placed, with_lowest_parts
from stack_counter.sim.hard.scan import HardScan
from stack_counter.sim.hard.world import block, floor, record_world, scene_meshes
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import Mesh


@dataclass(frozen=True)
class BinSettings:
    """How bins stand, and how wrongly they are given; all chosen.

    Attributes:
        views: of each scan.
        touching_gap_m, wide_gap_m: gaps between bins side by side: of a rack, and set down.
        margin_m: least and largest distance from a bin to the border of its region.
        board_height_m: range of what a bin stands on.
        board_margin_m: range by which that reaches beyond the bin.
        rail_width_m: width of rails.
        sunk_share: range of the share of a bin's height that stands in a recess.
        sunk_gap_m: range of the gap around it there.
        table_m: distance to which the table around a recess reaches.
        drafted_rad: least draft of a bin whose size is given as if its walls were vertical.
        wrong_size: factors of a wrong inner side, and of a wrong depth.
    """

    views: int = 6
    touching_gap_m: float = 0.002
    wide_gap_m: tuple[float, float] = (0.02, 0.08)
    margin_m: tuple[float, float] = (0.001, 0.012)
    board_height_m: tuple[float, float] = (0.012, 0.06)
    board_margin_m: tuple[float, float] = (0.0, 0.06)
    rail_width_m: float = 0.025
    sunk_share: tuple[float, float] = (0.1, 0.6)
    sunk_gap_m: tuple[float, float] = (0.004, 0.02)
    table_m: float = 1.5
    drafted_rad: float = 0.06
    wrong_size: tuple[float, ...] = (0.7, 0.8, 1.25, 1.4)


SETTINGS = BinSettings()


def make_neighbours(pile: Scene, random: np.random.Generator) -> HardScan:
    """A row of bins of the same kind, full, half full and empty; half of them with a region.

    The region is around one bin, of which the parts are asked for; without one, all.
    """
    size, number = outer_size(pile), int(random.integers(2, 5))
    wide = random.random() < 0.4
    gap = random.uniform(*SETTINGS.wide_gap_m) if wide else SETTINGS.touching_gap_m
    # Bins along x, each turned by half a turn from the one before it.
    row = [placed(with_lowest_parts(pile, random.choice([0.0, 0.5, 1.0], p=[0.35, 0.15, 0.5])),
                  np.array([(i - (number - 1) / 2) * (size[0] + gap), 0, 0]), np.pi * i)
           for i in range(number)]
    chosen = row[random.integers(number)]
    has_region = random.random() < 0.5
    # The camera goes around the bin that is asked for, or around the row.
    seen = [chosen] if has_region else row
    corners = np.array([scene.bounds() for scene in seen])
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    meshes = [mesh for scene in row for mesh in scene_meshes(scene)]
    views = record_world([floor(), *meshes], arc_poses(low, high, SETTINGS.views, random), random)
    what = f"{number} bins {1000 * gap:.0f} mm apart"
    if not has_region:
        return HardScan(f"{what}, no region", views, pile.truth.unit_volume,
                        sum(len(scene.poses) for scene in row))
    middle = chosen.container.T_world_container[:3, 3]
    side = size[:2] + 2 * min(gap / 2 + 1e-3, random.uniform(*SETTINGS.margin_m))
    config = ReconstructorConfig(
        roi_center_m=(float(middle[0]), float(middle[1]), float(size[2]) / 2 + 0.02),
        roi_size_m=(float(side[0]), float(side[1]), float(size[2]) + 0.1))
    return HardScan(f"{what}, region around one with {len(chosen.poses)} parts", views,
                    pile.truth.unit_volume, len(chosen.poses), config)


def make_raised(pile: Scene, random: np.random.Generator) -> HardScan:
    """A bin on a board, on two rails or on another bin; a third of them with the right size."""
    size = outer_size(pile)
    kind = ("board", "rails", "tote")[random.integers(3)]
    height = float(size[2]) if kind == "tote" else random.uniform(*SETTINGS.board_height_m)
    below = {"board": _board, "rails": _rails, "tote": _tote}[kind](pile, height, random)
    raised = placed(pile, np.array([0, 0, height]))
    low, high = raised.bounds()
    poses = arc_poses(low * [1, 1, 0], high, SETTINGS.views, random)
    views = record_world([floor(), *below, *scene_meshes(raised)], poses, random)
    shape, config, given = pile.container, ReconstructorConfig(), ""
    if shape.draft_rad == 0 and random.random() < 0.5:
        config = ReconstructorConfig(container_kind="box", container_wall_m=shape.wall_thickness_m,
                                     container_inner_size_m=shape.inner_size_m)
        given = ", its size given"
    return HardScan(f"{kind} of {1000 * height:.0f} mm below{given}", views,
                    pile.truth.unit_volume, len(pile.poses), config)


def _board(pile: Scene, height: float, random: np.random.Generator) -> list[Mesh]:
    half = outer_size(pile)[:2] / 2 + random.uniform(*SETTINGS.board_margin_m)
    return [block((*-half, 0), (*half, height))]


def _rails(pile: Scene, height: float, random: np.random.Generator) -> list[Mesh]:
    x, y = outer_size(pile)[:2] / 2
    y += random.uniform(*SETTINGS.board_margin_m)
    width = SETTINGS.rail_width_m
    return [block((-x, -y, 0), (-x + width, y, height)), block((x - width, -y, 0), (x, y, height))]


def _tote(pile: Scene, height: float, random: np.random.Generator) -> list[Mesh]:
    return scene_meshes(placed(pile, np.zeros(3)))


def make_sunk(pile: Scene, random: np.random.Generator) -> HardScan:
    """A bin in a recess of a table: what is level around it is not what it stands on."""
    size = outer_size(pile)
    depth = random.uniform(*SETTINGS.sunk_share) * float(size[2])
    gap = random.uniform(*SETTINGS.sunk_gap_m)
    sunk = placed(pile, np.array([0, 0, -depth]))
    low, high = sunk.bounds()
    poses = arc_poses(low * [1, 1, 0], high, SETTINGS.views, random)
    views = record_world([*_recess(size[:2] / 2 + gap, depth), *scene_meshes(sunk)], poses, random)
    return HardScan(f"{1000 * depth:.0f} of {1000 * size[2]:.0f} mm in a recess, gap "
                    f"{1000 * gap:.0f} mm", views, pile.truth.unit_volume, len(pile.poses))


def _recess(half: np.ndarray, depth: float) -> list[Mesh]:
    """A table at height 0 with a recess of half sides (2,) and a depth, metres."""
    (x, y), far = half, SETTINGS.table_m
    below = -depth - 0.01
    return [block((-far, -far, below), (-x, far, 0)), block((x, -far, below), (far, far, 0)),
            block((-x, -far, below), (x, -y, 0)), block((-x, y, below), (x, far, 0)),
            block((-x, -y, below), (x, y, -depth))]


def make_given_wrongly(pile: Scene, random: np.random.Generator) -> HardScan:
    """A bin given as if its walls were vertical though they are drafted, or with a wrong size."""
    shape, bin_ = pile.container, placed(pile, np.zeros(3), random.uniform(0, np.pi))
    x, y, depth = shape.inner_size_m
    kind = random.integers(2) if shape.draft_rad >= SETTINGS.drafted_rad else 2
    closing = 2 * depth * np.tan(shape.draft_rad)
    if kind == 0:
        given, what = (x, y, depth), "drafted, the size at its rim given"
    elif kind == 1:
        given, what = (x - closing, y - closing, depth), "drafted, the size at its floor given"
    else:
        wrong, axis = random.choice(SETTINGS.wrong_size), int(random.integers(3))
        size = [x, y, depth]
        size[axis] *= wrong
        given, what = (size[0], size[1], size[2]), f"{'xyz'[axis]} given as {wrong:.0%} of it"
    poses = arc_poses(*bin_.bounds(), SETTINGS.views, random)
    views = record_world([floor(), *scene_meshes(bin_)], poses, random)
    config = ReconstructorConfig(container_kind="box",
                                 container_inner_size_m=tuple(float(side) for side in given))
    return HardScan(what, views, pile.truth.unit_volume, len(pile.poses), config)
