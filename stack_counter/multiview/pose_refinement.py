"""Poses made to agree with the pictures: a robot's errors are small for its work, not for stereo.

Half a millimetre and a twentieth of a degree shift a picture by a pixel, and depth at 15 degrees
between two views by 4 mm. Matched points must lie on each other's epipolar lines; the reported
poses are the prior, and hold where the pictures say nothing.

Source: Lowe, "Distinctive Image Features from Scale-Invariant Keypoints" (2004); Hartley and
Zisserman, "Multiple View Geometry" (2004), section 11.4.3: the Sampson distance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix, identity, vstack
from scipy.spatial.transform import Rotation

from stack_counter.errors import ViewError
from stack_counter.types import View

_POINTS = 2000  # of a picture
_PARTNERS = 6  # nearest cameras that a picture is matched with
_RATIO = 0.8  # best over second best distance of descriptors
_GATE_PX = 4.0  # farthest from its epipolar line that a match may lie before
_SIGMA_PX = 0.4  # of a matched point
# Standard deviations of the reported poses: turn (rad) about the camera's axes, and shift (m)
# along them.
_PRIOR = np.array([np.deg2rad(0.1)] * 3 + [0.001] * 3)
_STEP = 1e-4  # of numeric derivatives, in standard deviations of the prior


@dataclass(frozen=True)
class _Matches:
    """Points that two views share: views (p, 2) of every pair; pair (n,) of every match; rays
    (n, 2, 3) with z = 1; focal length (n,), pixels."""

    views: np.ndarray
    pair: np.ndarray
    rays: np.ndarray
    focal: np.ndarray

    def distances(self, T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
        """(n,) Sampson distances, pixels, for poses (p, 4, 4) of both views of every pair."""
        E = essential(T_a, T_b)[self.pair]
        line = np.einsum("nij,nj->ni", E, self.rays[:, 0])
        back = np.einsum("nij,ni->nj", E, self.rays[:, 1])
        norm = np.sqrt(np.sum(line[:, :2]**2 + back[:, :2]**2, axis=1))
        return self.focal * np.sum(line * self.rays[:, 1], axis=1) / np.maximum(norm, 1e-12)


def essential(T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrices E with ray_b @ E @ ray_a = 0 for rays to one point, of (..., 4, 4)
    poses of both cameras."""
    R_b = np.swapaxes(T_b[..., :3, :3], -1, -2)
    t = np.einsum("...ij,...j->...i", R_b, T_a[..., :3, 3] - T_b[..., :3, 3])
    cross = np.zeros((*t.shape, 3))
    cross[..., [2, 0, 1], [1, 2, 0]], cross[..., [1, 2, 0], [2, 0, 1]] = t, -t
    return cross @ R_b @ T_a[..., :3, :3]


def refine_poses(views: list[View]) -> list[View]:
    """The views with poses on which their pictures agree.

    Args:
        views: pinhole views with colour, and poses near the true ones.

    Raises:
        ViewError: reason `no_color`.
    """
    poses = np.array([view.T_world_camera for view in views])
    matches = _matched(views, poses)
    if matches is None or not len(matches.pair):
        return views
    a, b = matches.views.T

    def residuals(x: np.ndarray) -> np.ndarray:
        T = _moved(poses, x.reshape(-1, 6))
        return np.append(matches.distances(T[a], T[b]) / _SIGMA_PX, x)

    def jacobian(x: np.ndarray) -> csr_matrix:
        T = _moved(poses, x.reshape(-1, 6))
        start = matches.distances(T[a], T[b])
        rows, columns, values = [], [], []
        for k, way in enumerate(_STEP * np.eye(6)):
            near = _moved(T, np.tile(way, (len(T), 1)))
            for side, there in ((a, (near[a], T[b])), (b, (T[a], near[b]))):
                rows.append(np.arange(len(start)))
                columns.append(6 * side[matches.pair] + k)
                values.append((matches.distances(*there) - start) / (_STEP * _SIGMA_PX))
        slopes = csr_matrix((np.concatenate(values), (np.concatenate(rows),
                                                      np.concatenate(columns))),
                            shape=(len(start), 6 * len(T)))
        return vstack([slopes, identity(6 * len(T))]).tocsr()

    found = least_squares(residuals, np.zeros(6 * len(views)), jacobian, loss="cauchy",
                          tr_solver="lsmr", max_nfev=15)
    return [replace(view, T_world_camera=T)
            for view, T in zip(views, _moved(poses, found.x.reshape(-1, 6)))]


def _moved(poses: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n, 4, 4) poses turned and shifted by (n, 6) standard deviations of the prior."""
    change = np.tile(np.eye(4), (len(x), 1, 1))
    change[:, :3, :3] = Rotation.from_rotvec(x[:, :3] * _PRIOR[:3]).as_matrix()
    change[:, :3, 3] = x[:, 3:] * _PRIOR[3:]
    return poses @ change


def _matched(views: list[View], poses: np.ndarray) -> _Matches | None:
    """What the pictures share, each with those of the nearest cameras; None if all are in one
    place."""
    found = [_points(view) for view in views]
    eyes = poses[:, :3, 3]
    away = np.linalg.norm(eyes[:, None] - eyes, axis=-1)
    pairs: list[tuple[int, int]] = []
    pair, rays, focal = [], [], []
    for i in range(len(views)):
        others = [int(j) for j in np.argsort(away[i]) if away[i, j] > 0]  # or no epipolar line
        for j in others[:_PARTNERS]:
            if (j, i) in pairs:
                continue
            (rays_i, words_i), (rays_j, words_j) = found[i], found[j]
            E = essential(poses[i], poses[j])
            lines = rays_i @ E.T
            off = np.abs(lines @ rays_j.T) / np.linalg.norm(lines[:, :2], axis=1)[:, None]
            chosen = _agreeing(words_i, words_j, off * views[j].intrinsics.fx < _GATE_PX)
            pair.append(np.full(len(chosen), len(pairs)))
            rays.append(np.stack([rays_i[chosen[:, 0]], rays_j[chosen[:, 1]]], axis=1))
            focal.append(np.full(len(chosen), views[i].intrinsics.fx))
            pairs.append((i, j))
    if not pairs:
        return None
    return _Matches(np.array(pairs), np.concatenate(pair), np.concatenate(rays),
                    np.concatenate(focal))


def _points(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Rays (n, 3) with z = 1 and descriptors (n, 128) float32 of the picture's corners."""
    if view.color is None:
        raise ViewError("no_color", "the view has no colour image; expected one")
    grey = cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY)
    # Without precise upscaling, OpenCV's corners lie a quarter of a pixel beside their place.
    sift = cv2.SIFT.create(_POINTS, enable_precise_upscale=True)
    corners, words = sift.detectAndCompute(grey, None)
    pixels = np.array([corner.pt for corner in corners], float).reshape(-1, 2)
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(view.intrinsics.K).T
    return rays, np.zeros((0, 128), np.float32) if words is None else words


def _agreeing(words_a: np.ndarray, words_b: np.ndarray, possible: np.ndarray) -> np.ndarray:
    """(n, 2) indices of descriptors that are clearly each other's nearest among the `possible`
    (a, b) ones, which may be together."""
    if min(possible.shape) < 2:
        return np.zeros((0, 2), int)
    apart = np.where(possible, np.sum(words_a**2, axis=1)[:, None] + np.sum(words_b**2, axis=1)
                     - 2 * words_a @ words_b.T, np.float32(np.inf))
    nearest, back = np.argmin(apart, axis=1), np.argmin(apart, axis=0)
    best, second = np.sqrt(np.maximum(np.partition(apart, 1, axis=1)[:, :2], 0)).T
    here = np.arange(len(words_a))
    good = (back[nearest] == here) & (best < _RATIO * second)
    return np.stack([here[good], nearest[good]], axis=1)
