# SPDX-License-Identifier: Apache-2.0
"""What stereo on pictures does to a surface, as a model of a few numbers.

A place has to be seen by several views at once, and a window has to fit into it: what few views
see is filled in from beside it, as the run time does. What is left is fattened, smoothed and
noisy, in proportion to the resolution. `train.stereo_surface` fits and checks the model.
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
        fattening: radius by which what stands higher is widened.
        smoothing: standard deviation of the blur.
        least_smoothing_px: the same of bringing the map to the network's pixels, pixels.
        noise: standard deviation of the surface's error.
        noise_width: standard deviation of the blur that makes that error smooth.
    """

    least_share: float = 0.274
    share_growth: float = 0.443
    share_std: float = 0.0911
    fattening: float = 0.432
    smoothing: float = 0.165
    least_smoothing_px: float = 0.178
    noise: float = 0.318
    noise_width: float = 3.07


SETTINGS = StereoSurfaceSettings()


@dataclass(frozen=True)
class PictureSettings:
    """How strong the degradation is, drawn anew for a sample; chosen.

    Attributes:
        resolution: range of the resolution, part lengths, drawn evenly in its logarithm; a
            voxel at least.
        spread: standard deviation of the log of a factor by which fattening, smoothing and noise
            differ from scan to scan at one resolution.
        floor_std: standard deviation of the inner surface's level, resolutions.
    """

    resolution: tuple[float, float] = (0.03, 0.4)
    spread: float = 0.25
    floor_std: float = 0.2


PICTURES = PictureSettings()


def draw_resolution(part_length_m: float, random: np.random.Generator) -> float:
    """Draws a resolution of stereo, part lengths, for parts of a size in metres."""
    drawn = float(np.exp(random.uniform(*np.log(PICTURES.resolution))))
    return max(drawn, voxel_size_for(part_length_m**3) / part_length_m)


def degrade_like_stereo(sample: Sample, resolution: float, random: np.random.Generator
                        ) -> StackMaps:
    """Makes a sample's maps as stereo on pictures might show them.

    Args:
        sample: as rays have cast it, with the share of the views that see each place.
        resolution: part lengths.
        random: draws the noise.
    """
    maps, factor = sample.maps, np.exp(random.normal(0, PICTURES.spread, 3))
    settings = replace(SETTINGS, fattening=SETTINGS.fattening * factor[0],
                       smoothing=SETTINGS.smoothing * factor[1], noise=SETTINGS.noise * factor[2])
    top = stereo_surface(maps.top, sample.seen_share, maps.valid, resolution, random, settings)
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
    if known.any():
        top = fill_unknown_cells(np.where(known, top, np.nan), known).astype(np.float32)
    # Widen what stands higher, smooth, and add noise.
    top = _widen(np.where(valid, top, -np.inf).astype(np.float32), s.fattening * window)
    sigma = float(np.hypot(s.smoothing * window, s.least_smoothing_px))
    weight = _blur(valid.astype(np.float32), sigma)
    top = _blur(np.where(valid, top, 0), sigma) / np.maximum(weight, 1e-3)
    top += s.noise * resolution * _smooth_noise(top.shape, width, random)
    return np.where(valid, top, 0).astype(np.float32)


def _widen(top: np.ndarray, radius: float) -> np.ndarray:
    """Highest of the surroundings of any radius in pixels, between those of whole ones."""
    whole = int(radius)
    inside, outside = (_dilate(top, whole + more) for more in (0, 1))
    finite = np.isfinite(inside)
    share = radius - whole
    return np.where(finite, (1 - share) * np.where(finite, inside, 0) + share * outside, outside)


def _dilate(top: np.ndarray, radius: int) -> np.ndarray:
    """Highest of a disc around each pixel."""
    return cv2.dilate(top, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2))


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
