# SPDX-License-Identifier: Apache-2.0
"""Psi: the thickness of a container's wall as a share of its width, from crops of its views.

The network reads a crop of a view's depth around the container: every pixel tells where its point
lies to the outer face, in shares of the container's width. It is asked where geometry cannot
measure the wall: where parts hide the rim's inner edge.

Source: paper, section 3.3: dilated convolutions, a ratio of the container's size, averaged over
the views; there Psi reads features of the whole picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.container.inner_surface import outline_area
from stack_counter.container.wall_fit import Thickness
from stack_counter.errors import ViewError
from stack_counter.files import read_weights, shipped_weights
from stack_counter.inference import NetworkSession
from stack_counter.types import View, WallShape, spread_views

SHIPPED = "wall.safetensors"
FORMAT = "stack_counter wall 1"
SIDE = 128
CHANNELS = 3  # height over the rim, depth inside the outer face, validity


@dataclass(frozen=True)
class WallCropSettings:
    """What a crop shows; all values are chosen, and weights are trained for them.

    Attributes:
        margin: part of the container's span that the crop adds on each side.
        reach: heights over the rim and depths inside the face, over the container's width, at
            which they are cut off.
        min_depth_share: least part of the crop that has depth.
        min_span: least number of pixels that the container spans.
        max_views: largest number of views used, evenly spread over the scan.
    """

    margin: float = 0.08
    reach: float = 0.3
    min_depth_share: float = 0.2
    min_span: int = 24
    max_views: int = 6


CROP_SETTINGS = WallCropSettings()


@cache
def load_wall_net(path: Path | None = None) -> NetworkSession:
    """Reads the network; None is the file shipped with the package.

    Of `crops`, (b, CHANNELS, SIDE, SIDE) float32, it gives two (b,): logs of the thickness over
    the container's width, and of the scale of their error.

    Raises:
        WeightsError: the file is missing, not safetensors, of another format or not whole.
    """
    path = path or shipped_weights(SHIPPED)
    return NetworkSession(path, read_weights(path, FORMAT).tensors)


def estimate_thickness(views: Sequence[View], shape: WallShape, height: float, plane_z: float
                       ) -> Thickness | None:
    """Estimates a wall's thickness; None where no view shows the container.

    Args:
        views: with depth.
        shape: outer face of the wall, world frame.
        height: of the rim over the support plane, metres.
        plane_z: world height of the support plane, metres.
    """
    # Crop the views around the container.
    crops = []
    for view in spread_views(views, CROP_SETTINGS.max_views):
        try:
            crops.append(wall_crop(view, shape, height, plane_z))
        except ViewError:
            continue  # another view shows it
    if not crops:
        return None
    # Average the network's answers; the standard deviation of Laplace's is sqrt(2) scales.
    mean, log_scale = load_wall_net()(crops=np.stack(crops))
    thickness = float(np.exp(mean).mean()) * outer_width(shape)
    return Thickness(thickness, float(np.sqrt(2) * np.exp(log_scale).mean()) * thickness)


def outer_width(shape: WallShape) -> float:
    """Width that a thickness is a share of: root of the area within the rim's outline, metres."""
    return float(np.sqrt(outline_area(shape.ring(0.0, 0.0))))


def wall_crop(view: View, shape: WallShape, height: float, plane_z: float) -> np.ndarray:
    """Makes the network's input: (CHANNELS, SIDE, SIDE) float32.

    Args:
        view: with depth.
        shape: outer face of the wall, world frame.
        height: of the rim over the support plane, metres.
        plane_z: world height of the support plane, metres.

    Raises:
        ViewError: reasons `no_depth`, or `out_of_sight` where the view hardly shows the container.
    """
    s = CROP_SETTINGS
    if view.depth is None:
        raise ViewError("no_depth", "the view has no depth image; expected one")
    # Where the image shows the container's outline, at the rim and at the foot.
    outline = shape.ring(0.0, 0.0)
    corners = np.concatenate([np.column_stack([outline, np.full(len(outline), z)])
                              for z in (plane_z + height, plane_z)])
    T_camera_world = geometry.inverse(view.T_world_camera)
    pixels, z = geometry.project(geometry.apply(T_camera_world, corners), view.intrinsics)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    span = float((high - low).max()) * (1 + 2 * s.margin)
    if z.min() <= 0 or span < s.min_span:
        raise ViewError("out_of_sight", f"the container spans {span:.0f} pixels, its nearest "
                                        f"point at {z.min():.2f} m; expected at least "
                                        f"{s.min_span} pixels in front of the camera")
    # Resample around that, without mixing in more than the crop's pixels cover.
    scale = SIDE / span
    shift = SIDE / 2 - scale * (low + high) / 2
    matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    crop = cv2.warpAffine(_channels(view, shape, height, plane_z), matrix, (SIDE, SIDE),
                          flags=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    if crop[..., 2].mean() < s.min_depth_share:
        raise ViewError("out_of_sight", f"{crop[..., 2].mean():.0%} of the crop around the "
                                        "container have depth; expected at least "
                                        f"{s.min_depth_share:.0%}")
    return np.ascontiguousarray(crop.transpose(2, 0, 1))  # (CHANNELS, SIDE, SIDE)


def _channels(view: View, shape: WallShape, height: float, plane_z: float) -> np.ndarray:
    """(h, w, CHANNELS) float32 of a whole view; arguments are those of `wall_crop`."""
    depth = np.asarray(view.depth)
    reach, width = CROP_SETTINGS.reach, outer_width(shape)
    points = geometry.apply(view.T_world_camera, geometry.unproject(depth, view.intrinsics))
    xy = points[..., :2].reshape(-1, 2)
    above = points[..., 2] - plane_z - height
    inside = shape.depth_inside(xy, np.zeros(len(xy))).reshape(above.shape)
    valid = (depth > 0).astype(np.float32)
    return np.stack([np.clip(above / width, -reach, reach) * valid,
                     np.clip(inside / width, -reach, reach) * valid, valid],
                    axis=-1).astype(np.float32)
