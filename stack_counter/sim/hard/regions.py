# SPDX-License-Identifier: Apache-2.0
"""Hard because of where one looks: a region beside the bin or inside it, or a camera too close."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.sim.camera.recording import CAMERA, arc_poses
from stack_counter.sim.hard.piles import outer_size, parts_within, placed, scaled
from stack_counter.sim.hard.scan import HardScan
from stack_counter.sim.hard.world import floor, record_world, scene_meshes
from stack_counter.sim.scenes.scene import Scene


@dataclass(frozen=True)
class LookSettings:
    """Where regions lie, and how close a camera is; all chosen.

    Attributes:
        views, close_views: of a scan, and of one from close above.
        beside, partly: ranges of a region's distance from the bin, in its widths.
        region_start_m: heights of a region's lower side that start at the support plane or cut a
            little of the bin.
        headroom_m: how far a region reaches above the rim.
        inset_m: how much smaller than the rim opening a region within it is.
        opening_m: smaller side to which a bin is scaled that a camera is close above.
        in_sight: range of the share of that side that a close camera sees.
        close_play_m: how far close cameras stand from each other, horizontally.
    """

    views: int = 6
    close_views: int = 4
    beside: tuple[float, float] = (1.15, 1.6)
    partly: tuple[float, float] = (0.25, 0.6)
    region_start_m: tuple[float, ...] = (0.0, 0.005, 0.02)
    headroom_m: float = 0.06
    inset_m: float = 0.002
    opening_m: float = 0.32
    in_sight: tuple[float, float] = (0.7, 1.05)
    close_play_m: float = 0.06


SETTINGS = LookSettings()


def make_region_aside(pile: Scene, random: np.random.Generator) -> HardScan:
    """A region beside the bin, over a part of it, within its rim, or from the plane upwards."""
    bin_, size, top = placed(pile, np.zeros(3)), outer_size(pile), outer_size(pile)[2]
    kind = int(random.integers(4))
    half, shift, bottom = size[:2] / 2 + 0.01, np.zeros(2), -0.05
    if kind == 0:
        shift[random.integers(2)] = random.uniform(*SETTINGS.beside) * size[:2].max()
        what = "region beside the bin"
    elif kind == 1:
        axis = random.integers(2)
        shift[axis] = random.uniform(*SETTINGS.partly) * size[axis]
        what = "region over a part of the bin"
    elif kind == 2:
        half = np.array(pile.container.inner_size_m[:2]) / 2 - SETTINGS.inset_m
        what = "region within the rim"
    else:
        bottom = random.choice(SETTINGS.region_start_m)
        what = f"region from {1000 * bottom:.0f} mm above the support plane"
    low, high = np.append(shift - half, bottom), np.append(shift + half, top + SETTINGS.headroom_m)
    config = ReconstructorConfig(roi_center_m=tuple(map(float, (low + high) / 2)),
                                 roi_size_m=tuple(map(float, high - low)))
    poses = arc_poses(*bin_.bounds(), SETTINGS.views, random)
    views = record_world([floor(), *scene_meshes(bin_)], poses, random)
    # A region that is too low only by its start asks for all parts.
    low[2] = -1.0
    return HardScan(what, views, pile.truth.unit_volume, parts_within(bin_, low, high), config)


def make_no_plane(pile: Scene, random: np.random.Generator) -> HardScan:
    """A camera so close above a full bin that it sees little more than parts."""
    opening = min(pile.container.inner_size_m[:2])
    bin_ = placed(scaled(pile, SETTINGS.opening_m / opening), np.zeros(3),
                  np.pi / 2 * float(pile.container.inner_size_m[0] < opening + 1e-9))
    share = random.uniform(*SETTINGS.in_sight)
    top = outer_size(bin_)[2]
    above = share * SETTINGS.opening_m * CAMERA.fy / CAMERA.height
    poses = []
    for _ in range(SETTINGS.close_views):
        xy = random.uniform(-SETTINGS.close_play_m, SETTINGS.close_play_m, 2) / 2
        poses.append(geometry.look_at(np.append(xy, top + above), np.append(-xy / 4, top)))
    views = record_world([floor(), *scene_meshes(bin_)], poses, random)
    return HardScan(f"{share:.0%} of a bin's width in sight", views, bin_.shape.unit_volume,
                    len(bin_.poses))
