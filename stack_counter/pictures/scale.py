# SPDX-License-Identifier: Apache-2.0
"""How long the unit of a reconstruction is, metres, and how exactly that is known.

Marked points are triangulated; what their marks' residuals leave open goes into the error.

Source: Hartley and Zisserman, "Multiple View Geometry" (2003), section 12; Umeyama, "Least-squares
estimation of transformation parameters between two point patterns" (1991).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from stack_counter import geometry
from stack_counter.errors import BagError, ScanError
from stack_counter.pictures.reference import Reference
from stack_counter.pictures.structure_from_motion import Camera
from stack_counter.pictures.targets import RigidTarget


@dataclass(frozen=True)
class ScaleSettings:
    """When a scale is believed; all are chosen.

    Attributes:
        length_std_m: standard deviation of a length that a person measures, m: half a
            millimetre of a ruler.
        min_relative_std: least relative standard deviation of a scale: that of the poses' shape.
        max_relative_std: largest one; V's is three times as large.
        max_residual: largest distance of a mark from where the triangulated point shows, longer
            sides of its picture.
        max_disagreement: largest relative difference of two references' scales.
    """

    length_std_m: float = 0.0005
    min_relative_std: float = 0.001
    max_relative_std: float = 0.05
    max_residual: float = 0.01
    max_disagreement: float = 0.05


SETTINGS = ScaleSettings()


@dataclass(frozen=True)
class Scale:
    """Metres in the unit of a reconstruction, and its relative standard deviation."""

    metres: float
    relative_std: float


@dataclass(frozen=True, eq=False)
class _Triangulated:
    """A point (3,), its covariance (3, 3) for marks of one pixel, and its marks' residuals.

    Attributes:
        residuals: (m, 2) pixels from the marks to where the point shows.
    """

    point: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray


def measure_scale(references: Sequence[tuple[Reference, Sequence[RigidTarget]]],
                  cameras: Mapping[str, Camera]) -> Scale:
    """Measures the scale by all references.

    Args:
        references: each with the targets that the pictures show of it.
        cameras: of the pictures that registered, by name.

    Raises:
        BagError: too few marked pictures registered, marks do not meet in a point, the scale is
            too uncertain, or references disagree.
    """
    scales = [_scale_of(reference, targets, cameras) for reference, targets in references]
    low, high = min(s.metres for s in scales), max(s.metres for s in scales)
    if high > low * (1 + SETTINGS.max_disagreement):
        raise BagError("the references give scales of " + ", ".join(
            f"{scale.metres:.4g} ('{reference.text}')"
            for scale, (reference, _) in zip(scales, references))
            + f" m; expected all within {SETTINGS.max_disagreement:.0%}: check lengths and marks")
    return _joined(scales)


def _scale_of(reference: Reference, targets: Sequence[RigidTarget],
              cameras: Mapping[str, Camera]) -> Scale:
    """Measures the scale by one reference.

    Raises:
        BagError: none of its targets can be measured, or the scale is too uncertain.
    """
    scales, size_stds, errors = [], [], []
    for target in targets:
        try:
            scales.append(_measure_target(target, cameras))
            size_stds.append(target.size_std)
        except BagError as error:
            errors.append(str(error))
    if not scales:
        raise BagError(f"reference '{reference.text}': {errors[0]}")
    joined = _joined(scales)
    relative_std = math.hypot(joined.relative_std, SETTINGS.length_std_m / reference.length,
                              SETTINGS.min_relative_std, float(np.mean(size_stds)))
    if relative_std > SETTINGS.max_relative_std:
        raise BagError(f"reference '{reference.text}' gives the scale within {relative_std:.1%}; "
                       f"expected {SETTINGS.max_relative_std:.0%}: take a longer one, and mark it "
                       "in more pictures, taken from farther apart")
    return Scale(joined.metres, relative_std)


def _measure_target(target: RigidTarget, cameras: Mapping[str, Camera]) -> Scale:
    """Measures the scale by one rigid target.

    Raises:
        BagError: fewer than two of its points can be triangulated, or their marks do not meet.
    """
    # Triangulate what two or more registered pictures show.
    found: list[_Triangulated] = []
    known = []
    for point, marks in zip(target.points, target.marks):
        seen = {name: pixel for name, pixel in marks.items() if name in cameras}
        if len(seen) >= 2:
            found.append(_triangulate(target.name, seen, cameras))
            known.append(point)
    if len(found) < 2:
        lost = sorted({name for marks in target.marks for name in marks} - set(cameras))
        raise BagError(f"{len(found)} points of {target.name} show in two or more pictures that "
                       "registered; expected two or more points"
                       + (f": {', '.join(lost[:4])} did not register" if lost else ""))
    # Fit the known shape to them: its size is the scale.
    points = np.array([one.point for one in found])
    metric = np.array(known)
    spread, metric_spread = points - points.mean(axis=0), metric - metric.mean(axis=0)
    u, singular, vt = np.linalg.svd(metric_spread.T @ spread)
    singular[-1] *= np.sign(np.linalg.det(u @ vt))
    size = float((spread**2).sum())
    metres = float(singular.sum()) / size
    # The marks' error by their residuals, propagated to the scale; and the misfit of the shape.
    residuals = np.concatenate([one.residuals for one in found])
    freedom = residuals.size - 3 * len(found)
    pixel_std = max(target.pixel_std, math.sqrt(float((residuals**2).sum()) / freedom))
    variance = pixel_std**2 * sum(
        float(way @ one.covariance @ way) for way, one in zip(spread, found)) / size**2
    misfit = max(float((metric_spread**2).sum()) - metres**2 * size, 0.0)
    shape_freedom = 3 * len(found) - 7
    if shape_freedom > 0:
        variance = max(variance, misfit / shape_freedom / float((metric_spread**2).sum()))
    return Scale(metres, math.sqrt(variance))


def _triangulate(name: str, marks: Mapping[str, tuple[float, float]],
                 cameras: Mapping[str, Camera]) -> _Triangulated:
    """Finds the point that two or more pictures show.

    Raises:
        BagError: the pictures look along one direction, or the marks do not meet in a point.
    """
    # Rays without distortion, in the optical frames and in the world.
    seen = [cameras[picture] for picture in marks]
    slopes = np.array([_undistorted(camera, pixel) for camera, pixel in zip(seen, marks.values())])
    focal = np.array([[camera.intrinsics.fx] for camera in seen])
    rays = np.column_stack([slopes, np.ones(len(seen))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    poses = [camera.T_world_camera for camera in seen]
    try:
        start = geometry.nearest_point_to_rays(
            np.array([T[:3, 3] for T in poses]),
            np.array([T[:3, :3] @ ray for T, ray in zip(poses, rays)]))
    except ScanError as error:
        raise BagError(f"{name}: {', '.join(marks)} look at it along one direction; expected "
                       "pictures taken from apart") from error

    def residuals(point: np.ndarray) -> np.ndarray:
        local = np.array([geometry.apply(geometry.inverse(T), point) for T in poses])
        return ((local[:, :2] / local[:, 2:] - slopes) * focal).ravel()

    # Refine it to the least sum of squared pixels.
    fit = least_squares(residuals, start, x_scale=max(float(np.linalg.norm(start)), 1e-9) * 1e-3)
    misses = fit.fun.reshape(-1, 2)
    worst = int(np.argmax(np.linalg.norm(misses, axis=1)))
    k = seen[worst].intrinsics
    allowed = SETTINGS.max_residual * max(k.width, k.height)
    if np.linalg.norm(misses[worst]) > allowed:
        raise BagError(f"a mark of {name} in {list(marks)[worst]} lies "
                       f"{np.linalg.norm(misses[worst]):.0f} pixels beside where the other "
                       f"pictures show it; expected up to {allowed:.0f}: mark the same point in "
                       "all of them")
    return _Triangulated(fit.x, np.linalg.inv(fit.jac.T @ fit.jac), misses)


def _undistorted(camera: Camera, pixel: tuple[float, float]) -> np.ndarray:
    """(2,) slopes x / z and y / z of the ray through a pixel of a picture."""
    k = camera.intrinsics
    return cv2.undistortPoints(np.array([[pixel]], float), k.K, np.array(k.distortion)).ravel()


def _joined(scales: Sequence[Scale]) -> Scale:
    """The weighted mean of scales; its error is widened where they differ by more than theirs.

    Source: Birge, "The Calculation of Errors by the Method of Least Squares" (1932).
    """
    weights = np.array([scale.relative_std**-2 for scale in scales])
    logs = np.log([scale.metres for scale in scales])
    mean = float(weights @ logs / weights.sum())
    birge = float(weights @ (logs - mean)**2) / max(len(scales) - 1, 1)
    return Scale(math.exp(mean), math.sqrt(max(birge, 1.0) / weights.sum()))
