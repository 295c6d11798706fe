# SPDX-License-Identifier: Apache-2.0
"""What messages state of themselves, compared with what they hold before any of it is used.

Whoever reaches the ROS domain may send anything; a message that does not fit itself is refused.
"""

from __future__ import annotations

import math

import numpy as np
from stack_counter_msgs.msg import HeightMap, KeyView, PosedImage, StackVolume

from stack_counter.errors import ScanError, ViewError
from stack_counter.views.decoding import intrinsics_of_camera_info

_HIGHEST_M = 1000.0  # of a surface over the plane of its map; chosen


def check_image_sizes(message: PosedImage | KeyView) -> None:
    """Checks that the images of a view are of the size of their calibration.

    Raises:
        ViewError: one is not (`size_mismatch`).
    """
    camera = intrinsics_of_camera_info(message.camera_info)
    for image in (message.color, message.depth, message.labels):
        if len(image.data) and (image.width, image.height) != (camera.width, camera.height):
            raise ViewError("size_mismatch", f"image of {image.width}x{image.height}; expected "
                                             f"{camera.width}x{camera.height} as in its "
                                             "camera_info")


def check_map(message: HeightMap) -> None:
    """Checks that a height map has the cells that it states.

    Raises:
        ScanError: it has not, its cells have no size, or its heights are those of nothing that a
            camera sees.
    """
    cells, count = message.rows * message.cols, len(message.heights)
    if cells != count or not (math.isfinite(message.pitch) and message.pitch > 0):
        raise ScanError(f"height map of {message.rows}x{message.cols} cells, {count} heights and "
                        f"pitch {message.pitch} m; expected {cells} heights and a pitch above 0")
    heights = np.abs(np.asarray(message.heights))
    if (highest := heights[np.isfinite(heights)].max(initial=0.0)) > _HIGHEST_M:
        raise ScanError(f"height map with {highest:.3g} m; expected at most {_HIGHEST_M:g} m")


def check_volume(message: StackVolume) -> None:
    """Checks that the figures of a volume can be those of a stack.

    Raises:
        ScanError: V or its standard deviation is negative or not finite, or the surfaces are not
            on one grid.
    """
    figures = (message.stack_volume, message.stack_volume_std)
    if not all(math.isfinite(figure) and figure >= 0 for figure in figures):
        raise ScanError(f"stack_volume is {figures[0]} +- {figures[1]} m3; expected finite "
                        "numbers, 0 or more")
    top, inner = ((m.rows, m.cols) for m in (message.top, message.inner))
    if top != inner:
        raise ScanError(f"top surface of {top[0]}x{top[1]} cells over an inner surface of "
                        f"{inner[0]}x{inner[1]}; expected one grid")
