# SPDX-License-Identifier: Apache-2.0
"""What stereo on pictures does to a surface, as a model of a few numbers.

A place has to be seen by several views at once, and a window has to fit into it. What few views
see is filled in from beside it: by the run time, which takes the lowest, or by the stereo, which
passes smoothly from one side to the other. What is left is evened between edges, smoothed and
noisy.
`train.stereo_surface` fits and checks the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter.fusion.tsdf import voxel_size_for
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, StackMaps
from stack_counter.reconstruction.integral import fill_unknown_cells
from stack_counter.train.data.heights import Sample


@dataclass(frozen=True)
class StereoSurfaceSettings:
    """The model; lengths are in resolutions, the surface's stereo window or voxel.

    Fitted by `python -m stack_counter.train.stereo_surface fit PAIRS`.

    Attributes:
        least_share: share of an arc's views that must see a place, at the finest resolution.
        share_growth: by how much that share grows with the resolution in part lengths.
        share_std: standard deviation of the share that is needed, from place to place.
        bridging: share of the way from the lowest height beside a place that few views see to
            the mean one, at which it is filled in.
        evening_px: standard deviation of the blur that stops at edges, pixels.
        evening_height: difference of heights that is such an edge, part lengths.
        smoothing: standard deviation of the blur.
        least_smoothing_px: the same of bringing the map to the network's pixels, pixels.
        noise: standard deviation of the surface's error.
        noise_width: standard deviation of the blur that makes that error smooth.
    """

    least_share: float = 0.349
    share_growth: float = 0.165
    share_std: float = 0.103
    bridging: float = 0.32
    evening_px: float = 1.23
    evening_height: float = 0.288
    smoothing: float = 0.0371
    least_smoothing_px: float = 0.487
    noise: float = 0.032
    noise_width: float = 3.89


SETTINGS = StereoSurfaceSettings()


@dataclass(frozen=True)
class PictureSettings:
    """How strong the degradation is, drawn anew for a sample; chosen.

    Attributes:
        resolution: range of the resolution, part lengths, drawn evenly in its logarithm; a
            voxel at least. That of the pairs which the model was fitted to.
        spread: standard deviation of the log of a factor by which smoothing and noise differ from
            scan to scan at one resolution.
        floor_std: standard deviation of the inner surface's level, resolutions.
    """

    resolution: tuple[float, float] = (0.08, 0.3)
    spread: float = 0.25
    floor_std: float = 0.2


PICTURES = PictureSettings()
_EVENING_SIDE = 5  # pixels of the map
_BRIDGE = 2.0  # resolutions over which a place that few views see is bridged


def draw_resolution(part_length_m: float, random: np.random.Generator) -> float:
    """Draws a resolution of stereo, part lengths, for parts of a size in metres."""
    drawn = float(np.exp(random.uniform(*np.log(PICTURES.resolution))))
    return max(drawn, voxel_size_for(part_length_m**3) / part_length_m)


def draw_model(random: np.random.Generator) -> StereoSurfaceSettings:
    """Draws the model of one scan."""
    smoothing, noise = np.exp(random.normal(0, PICTURES.spread, 2))
    return replace(SETTINGS, smoothing=SETTINGS.smoothing * smoothing,
                   least_smoothing_px=SETTINGS.least_smoothing_px * smoothing,
                   noise=SETTINGS.noise * noise)


def degrade_like_stereo(sample: Sample, resolution: float, random: np.random.Generator
                        ) -> StackMaps:
    """Makes a sample's maps as stereo on pictures might show them.

    Args:
        sample: as rays have cast it, with the share of the views that see each place.
        resolution: part lengths.
        random: draws the noise.
    """
    maps = sample.maps
    top = stereo_surface(maps.top, sample.seen_share, maps.valid, resolution, random,
                         draw_model(random))
    inner = maps.top - maps.height + random.normal(0, PICTURES.floor_std * resolution)
    height = np.where(maps.valid, np.maximum(top - inner, 0), 0).astype(np.float32)
    return StackMaps(top, height, maps.valid, maps.wall)


def stereo_surface(top: np.ndarray, seen_share: np.ndarray, valid: np.ndarray, resolution: float,
                   random: np.random.Generator, settings: StereoSurfaceSettings = SETTINGS
                   ) -> np.ndarray:
    """Returns (rows, cols) float32 heights as stereo shows them, part lengths; 0 if not valid.

    Args:
        top: (rows, cols) float32 heights as cast, part lengths.
        seen_share: (rows, cols) float32 share of an arc's views that see each place.
        valid: (rows, cols) bool.
        resolution: part lengths.
        random: draws the noise.
        settings: the model.
    """
    s, window = settings, resolution * PIXELS_PER_LENGTH
    width = s.noise_width * window
    # Fill in what too few views see.
    needed = s.least_share + s.share_growth * resolution \
        + s.share_std * _smooth_noise(top.shape, width, random)
    known = valid & (seen_share >= needed)
    if not known.any():
        known = valid
    lowest = fill_unknown_cells(np.where(known, top, np.nan), known)
    mean = _mean_around(top, known, max(_BRIDGE * window, 1.0))
    top = np.where(known, top, lowest + s.bridging * np.maximum(mean - lowest, 0))
    # Even out what lies between edges, smooth, and add noise.
    top = cv2.bilateralFilter(top.astype(np.float32), _EVENING_SIDE, s.evening_height,
                              s.evening_px)
    top = _mean_around(top, valid, float(np.hypot(s.smoothing * window, s.least_smoothing_px)))
    top += s.noise * resolution * _smooth_noise(top.shape, width, random)
    return np.where(valid, top, 0).astype(np.float32)


def _mean_around(top: np.ndarray, known: np.ndarray, sigma: float) -> np.ndarray:
    """(rows, cols) float32 Gaussian mean of what is known around each pixel; 0 far from it."""
    weight = _blur(known.astype(np.float32), sigma)
    return _blur(np.where(known, top, 0), sigma) / np.maximum(weight, 1e-3)


def _blur(image: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur, over nothing outside; below a sixth of a pixel none."""
    if sigma < 1 / 6:
        return image.astype(np.float32)
    return cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma,
                            borderType=cv2.BORDER_CONSTANT)


def _smooth_noise(shape: tuple[int, ...], sigma: float, random: np.random.Generator
                  ) -> np.ndarray:
    """(rows, cols) float32 noise of standard deviation 1, smooth over `sigma` pixels."""
    noise = _blur(random.standard_normal(shape), max(sigma, 0.3))
    return noise / max(float(noise.std()), 1e-6)
