"""What the wall-thickness network reads: a crop of one view around the container, from its depth.

Source: paper, section 3.3, where Psi reads features of the whole picture; here every pixel says
where its point lies to the outer face, in shares of the container's width.
"""

from __future__ import annotations

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.container.wall_shapes import WallShape
from stack_counter.errors import ViewError
from stack_counter.types import View

SIDE = 128  # pixels of a crop
CHANNELS = 3  # height over the rim, depth inside the outer face, validity
_MARGIN = 0.08  # of the crop, around the container
_REACH = 0.3  # of the width, to which heights and depths are told apart
_SEEN = 0.2  # share of the crop that should have depth
_LEAST = 24  # pixels that the container should span


def outer_width(form: WallShape) -> float:
    """Square root of the area within the rim's outer outline, metres: what the thickness is a
    share of."""
    (x, y), (u, w) = form.ring(0.0, 0.0).T, np.roll(form.ring(0.0, 0.0), -1, axis=0).T
    return float(np.sqrt(np.sum(x * w - u * y) / 2))


def wall_crop(view: View, form: WallShape, height: float, plane_z: float) -> np.ndarray:
    """(CHANNELS, SIDE, SIDE) float32.

    Args:
        view: with depth.
        form: outer face of the wall, world frame.
        height: of the rim over the support plane, metres.
        plane_z: of the support plane, metres.

    Raises:
        ViewError: reasons `no_depth`, or `out_of_sight` where the view hardly shows the container.
    """
    if view.depth is None:
        raise ViewError("no_depth", "the view has no depth image; expected one")
    outline = form.ring(0.0, 0.0)
    corners = np.concatenate([np.column_stack([outline, np.full(len(outline), z)])
                              for z in (plane_z + height, plane_z)])
    T_camera_world = geometry.inverse(view.T_world_camera)
    pixels, z = geometry.project(geometry.apply(T_camera_world, corners), view.intrinsics)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    side = float((high - low).max()) * (1 + 2 * _MARGIN)
    if z.min() <= 0 or side < _LEAST:
        raise ViewError("out_of_sight", f"the container spans {side:.0f} pixels, its nearest "
                                        f"point at {z.min():.2f} m; expected at least {_LEAST} "
                                        "pixels in front of the camera")
    points = geometry.apply(view.T_world_camera, geometry.unproject(view.depth, view.intrinsics))
    above = points[..., 2] - plane_z - height
    xy = points[..., :2].reshape(-1, 2)
    inside = form.depth_inside(xy, np.zeros(len(xy))).reshape(above.shape)
    width = outer_width(form)
    valid = (view.depth > 0).astype(np.float32)
    stacked = np.stack([np.clip(above / width, -_REACH, _REACH) * valid,
                        np.clip(inside / width, -_REACH, _REACH) * valid, valid], axis=-1)
    scale = SIDE / side
    shift = SIDE / 2 - scale * (low + high) / 2
    matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    out = cv2.warpAffine(stacked.astype(np.float32), matrix, (SIDE, SIDE), flags=how)
    if out[..., 2].mean() < _SEEN:
        raise ViewError("out_of_sight", f"{out[..., 2].mean():.0%} of the crop around the "
                                        f"container have depth; expected at least {_SEEN:.0%}")
    return np.ascontiguousarray(out.transpose(2, 0, 1))
