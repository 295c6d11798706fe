# SPDX-License-Identifier: Apache-2.0
"""How thick a container's wall is before its faces are fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.container.rim import Rim
from stack_counter.container.wall_fit import Thickness
from stack_counter.container.wall_network import estimate_thickness
from stack_counter.fusion.region import Region, seen_from_one_side
from stack_counter.fusion.volume_model import volume_model
from stack_counter.types import View


@dataclass(frozen=True)
class WallThicknessSettings:
    """What is expected of a wall's thickness; chosen but for what stereo does.

    Attributes:
        rim_std: standard deviation of a wall's thickness measured on its rim, m.
        stereo_rim_windows: windows taken off a rim that stereo measured; it is 0.66 too wide
            (median of 11 containers of `train-deep`), and with this V has no bias on six boxes
            of training parts (`simulate --plan box --seed 77`).
        thinnest: thickness that is left of such a rim, m.
        unknown_thickness: what is assumed where nothing shows the thickness.
        configured_std: standard deviation of a configured thickness, m.
    """

    rim_std: float = 0.001
    stereo_rim_windows: float = 0.45
    thinnest: float = 0.0005
    unknown_thickness: Thickness = Thickness(mean=0.004, std=0.01)
    configured_std: float = 1e-6


SETTINGS = WallThicknessSettings()


def expected_thickness(rim: Rim, views: list[View], region: Region, config: ReconstructorConfig
                       ) -> Thickness:
    """Thickness of the wall before its fit: configured, else the rim's width, else guessed."""
    if config.container_wall_m > 0:
        return Thickness(config.container_wall_m, SETTINGS.configured_std)
    if np.isfinite(rim.width) and seen_from_one_side(views, region):
        # One camera above loses depth on both edges of the rim.
        model = volume_model()
        lost = model.lost_rim_width_m + model.lost_rim_width_per_noise * region.noise
        return Thickness(rim.width + lost, model.lost_rim_width_std * lost)
    if np.isfinite(rim.width):
        found = Thickness(rim.width, SETTINGS.rim_std)
    else:  # parts hide the rim's inner edge: the network
        found = estimate_thickness(views, rim.outline, rim.height, region.plane_z) \
            or SETTINGS.unknown_thickness
    spread = SETTINGS.stereo_rim_windows * region.stereo_window_m
    return replace(found, mean=max(found.mean - spread, min(found.mean, SETTINGS.thinnest)))
