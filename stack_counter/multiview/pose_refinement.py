# SPDX-License-Identifier: Apache-2.0
"""Poses made to agree with the pictures: a robot's errors are small for its work, not for stereo.

Half a millimetre and a twentieth of a degree shift a picture by a pixel, and depth at 15 degrees
between two views by 4 mm. Matched points must lie on each other's epipolar lines; the reported
poses are the prior, and hold where the pictures say nothing.

The arithmetic is the same for any number of threads: sums over all matches are those of sparse
matrices, which BLAS does not split.

Source: Lowe, "Distinctive Image Features from Scale-Invariant Keypoints" (2004); Hartley and
Zisserman, "Multiple View Geometry" (2004), section 11.4.3: the Sampson distance; Holland and
Welsch, "Robust regression using iteratively reweighted least-squares" (1977).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import cg
from scipy.spatial.transform import Rotation

from stack_counter.errors import ViewError
from stack_counter.types import UNSEEN, View


@dataclass(frozen=True)
class RefinementSettings:
    """How points are matched and poses adjusted; all chosen.

    Attributes:
        points: largest number of points that are taken from a picture.
        partners: number of nearest cameras that a picture is matched with.
        descriptor_ratio: largest ratio of the best to the second best distance of descriptors
            (Lowe, section 7.1).
        gate_px: largest distance from its epipolar line at which a match is taken, pixels.
        point_std_px: standard deviation of a matched point, pixels.
        rotation_std: standard deviation of the reported poses about each axis, rad.
        translation_std: standard deviation of the reported poses along each axis, m.
        derivative_step: step of numeric derivatives, in standard deviations of the prior.
        max_iterations: largest number of weighted least-squares problems that are solved.
        tolerance: the adjustment has converged when no pose moves by more, in standard deviations
            of the prior.
    """

    points: int = 2000
    partners: int = 6
    descriptor_ratio: float = 0.8
    gate_px: float = 4.0
    point_std_px: float = 0.4
    rotation_std: float = float(np.deg2rad(0.1))
    translation_std: float = 0.001
    derivative_step: float = 1e-4
    max_iterations: int = 30
    tolerance: float = 1e-4


SETTINGS = RefinementSettings()


@dataclass(frozen=True, eq=False)
class _Features:
    """Points of one picture that look like no other.

    Attributes:
        rays: (n, 3) float64 rays through them, optical frame, z = 1.
        descriptors: (n, 128) float32.
    """

    rays: np.ndarray
    descriptors: np.ndarray


@dataclass(frozen=True, eq=False)
class _Matches:
    """Points that two views share.

    Attributes:
        views: (p, 2) int indices of the two views of every pair.
        pair: (n,) int pair of every match.
        rays: (n, 2, 3) float64 rays in both views, optical frame, z = 1.
        focal: (n,) float64 focal length of the first view, pixels.
    """

    views: np.ndarray
    pair: np.ndarray
    rays: np.ndarray
    focal: np.ndarray

    def sampson_distances(self, T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
        """Returns the matches' distances from their epipolar lines, to first order.

        Args:
            T_a, T_b: (p, 4, 4) poses of both views of every pair.

        Returns:
            (n,) float64, signed, pixels.
        """
        E = essential_matrices(T_a, T_b)[self.pair]
        line = np.einsum("nij,nj->ni", E, self.rays[:, 0])
        back = np.einsum("nij,ni->nj", E, self.rays[:, 1])
        norm = np.sqrt(np.sum(line[:, :2]**2 + back[:, :2]**2, axis=1))
        return self.focal * np.sum(line * self.rays[:, 1], axis=1) / np.maximum(norm, 1e-12)


def essential_matrices(T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
    """Returns (..., 3, 3) matrices E with ray_b @ E @ ray_a = 0 for rays to one point.

    Args:
        T_a, T_b: (..., 4, 4) poses of both cameras in the world.
    """
    R_b = np.swapaxes(T_b[..., :3, :3], -1, -2)
    t = np.einsum("...ij,...j->...i", R_b, T_a[..., :3, 3] - T_b[..., :3, 3])
    cross = np.zeros((*t.shape, 3))
    cross[..., [2, 0, 1], [1, 2, 0]], cross[..., [1, 2, 0], [2, 0, 1]] = t, -t
    return cross @ R_b @ T_a[..., :3, :3]


def refine_poses(views: list[View]) -> list[View]:
    """Returns the views with poses on which their pictures agree.

    Args:
        views: pinhole views with colour, and poses near the true ones.

    Raises:
        ViewError: reason `no_color`, if a view has none.
    """
    poses = np.array([view.T_world_camera for view in views])
    # Match every picture with those of the nearest cameras.
    matches = _match_views(views, poses)
    if matches is None or not len(matches.pair):
        return views
    # Minimise the robust sum of distances by reweighted least squares.
    change = np.zeros((len(views), 6))
    for _ in range(SETTINGS.max_iterations):
        step = _least_squares_step(matches, poses, change)
        change += step
        if np.abs(step).max() < SETTINGS.tolerance:
            break
    return [replace(view, T_world_camera=T)
            for view, T in zip(views, _change_poses(poses, change))]


def _least_squares_step(matches: _Matches, poses: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Returns the (n, 6) step to the minimum of the linearised problem.

    Args:
        matches: what the views share.
        poses: (n, 4, 4) reported poses.
        change: (n, 6) present change of them, in standard deviations of the prior.
    """
    T = _change_poses(poses, change)
    residuals, jacobian = _linearise(matches, T)
    # Weigh each match as the Cauchy distribution does.
    weights = diags(1 / (1 + residuals**2))
    # Solve the normal equations; the prior adds the identity.
    normal = (jacobian.T @ weights @ jacobian + identity(change.size)).tocsr()
    gradient = jacobian.T @ (weights @ residuals) + change.ravel()
    step, _ = cg(normal, -gradient, rtol=1e-9, M=diags(1 / normal.diagonal()))
    return step.reshape(change.shape)


def _linearise(matches: _Matches, poses: np.ndarray) -> tuple[np.ndarray, csr_matrix]:
    """Returns residuals (m,) of the matches in standard deviations, and their derivatives.

    Args:
        matches: what the views share.
        poses: (n, 4, 4) around which the derivatives, (m, 6 n), are taken, per standard deviation
            of the prior.
    """
    a, b = matches.views.T
    distances = matches.sampson_distances(poses[a], poses[b])
    matches_range = np.arange(len(distances))
    rows, columns, values = [], [], []
    for k, direction in enumerate(SETTINGS.derivative_step * np.eye(6)):
        stepped = _change_poses(poses, np.tile(direction, (len(poses), 1)))
        for side, T_a, T_b in ((a, stepped[a], poses[b]), (b, poses[a], stepped[b])):
            difference = matches.sampson_distances(T_a, T_b) - distances
            rows.append(matches_range)
            columns.append(6 * side[matches.pair] + k)
            values.append(difference / (SETTINGS.derivative_step * SETTINGS.point_std_px))
    jacobian = csr_matrix((np.concatenate(values),
                           (np.concatenate(rows), np.concatenate(columns))),
                          shape=(len(distances), 6 * len(poses)))
    return distances / SETTINGS.point_std_px, jacobian


def _change_poses(poses: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Returns (n, 4, 4) poses turned about and shifted along their own axes.

    Args:
        poses: (n, 4, 4).
        change: (n, 6) rotation vectors and shifts, in standard deviations of the prior.
    """
    T = np.tile(np.eye(4), (len(change), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(change[:, :3] * SETTINGS.rotation_std).as_matrix()
    T[:, :3, 3] = change[:, 3:] * SETTINGS.translation_std
    return poses @ T


def _match_views(views: list[View], poses: np.ndarray) -> _Matches | None:
    """Returns what the pictures share, each with those of the nearest cameras.

    None if all cameras are in one place.
    """
    features = [_detect_features(view) for view in views]
    # Pair each view with its nearest ones; one at its very place has no epipolar lines.
    centers = poses[:, :3, 3]
    distances = np.linalg.norm(centers[:, None] - centers, axis=-1)
    pairs: list[tuple[int, int]] = []
    for i in range(len(views)):
        others = [int(j) for j in np.argsort(distances[i]) if distances[i, j] > 0]
        pairs += [(i, j) for j in others[:SETTINGS.partners] if (j, i) not in pairs]
    if not pairs:
        return None
    # Match the descriptors of each pair near the epipolar lines.
    pair, rays, focal = [], [], []
    for number, (i, j) in enumerate(pairs):
        E = essential_matrices(poses[i], poses[j])
        lines = features[i].rays @ E.T
        off = np.abs(lines @ features[j].rays.T) / np.linalg.norm(lines[:, :2], axis=1)[:, None]
        near = off * views[j].intrinsics.fx < SETTINGS.gate_px
        chosen = _match_descriptors(features[i].descriptors, features[j].descriptors, near)
        pair.append(np.full(len(chosen), number))
        rays.append(np.stack([features[i].rays[chosen[:, 0]],
                              features[j].rays[chosen[:, 1]]], axis=1))
        focal.append(np.full(len(chosen), views[i].intrinsics.fx))
    return _Matches(np.array(pairs), np.concatenate(pair), np.concatenate(rays),
                    np.concatenate(focal))


def _detect_features(view: View) -> _Features:
    """Returns the SIFT points of a view's picture."""
    if view.color is None:
        raise ViewError("no_color", "the view has no colour image; expected one")
    grey = cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY)
    # Without precise upscaling, OpenCV's points lie a quarter of a pixel beside their place.
    sift = cv2.SIFT.create(SETTINGS.points, enable_precise_upscale=True)
    seen = None if view.labels is None else (view.labels != UNSEEN).astype(np.uint8)
    corners, descriptors = sift.detectAndCompute(grey, seen)
    pixels = np.array([corner.pt for corner in corners], float).reshape(-1, 2)
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(view.intrinsics.K).T
    return _Features(rays, np.zeros((0, 128), np.float32) if descriptors is None else descriptors)


def _match_descriptors(a: np.ndarray, b: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Returns (m, 2) indices of descriptors that are clearly each other's nearest.

    Args:
        a, b: (n_a, 128), (n_b, 128) float32 descriptors; their values are whole numbers.
        allowed: (n_a, n_b) bool, those that may match.
    """
    if min(allowed.shape) < 2:
        return np.zeros((0, 2), int)
    # Squared distances of all allowed pairs.
    apart = np.where(allowed, np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2 * a @ b.T,
                     np.float32(np.inf))
    # Keep mutual nearest neighbours that are clearly nearer than the second.
    nearest, back = np.argmin(apart, axis=1), np.argmin(apart, axis=0)
    best, second = np.sqrt(np.maximum(np.partition(apart, 1, axis=1)[:, :2], 0)).T
    index = np.arange(len(a))
    good = (back[nearest] == index) & (best < SETTINGS.descriptor_ratio * second)
    return np.stack([index[good], nearest[good]], axis=1)
