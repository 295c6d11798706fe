# SPDX-License-Identifier: Apache-2.0
"""What fusion adds to a surface that an arc of views sees: blur, noise and a floor out of place.

The blur of the TSDF and of the depth's smoothing goes with the voxel, the noise with the camera.

    python -m stack_counter.train.data.degrade SCANS data/train-deep

prints the textures of truly fused surfaces over those of degraded ones.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stack_counter.fusion.tsdf import voxel_size_for
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, StackMaps, surface_features
from stack_counter.train.data.heights import Sample

_FEATURES = ("height", "side", "V", "unevenness", "step", "bend")  # of `surface_features`


@dataclass(frozen=True)
class DegradationSettings:
    """How strong the degradation is, each drawn anew for a sample.

    Chosen such that degraded maps agree with truly fused ones of the same scenes, as
    `python -m stack_counter.train.data.degrade SCANS SCENES` prints.

    Attributes:
        blur_voxels: range of the standard deviation of fusion's blur, voxels.
        resampling_blur_px: range of that of bringing the map to the network's pixels, pixels.
        noise_m: range of the standard deviation of the fused surface, metres.
        floor_std_m: standard deviation of the inner surface's level, metres.
    """

    blur_voxels: tuple[float, float] = (0.4, 0.65)
    resampling_blur_px: tuple[float, float] = (0.2, 0.55)
    noise_m: tuple[float, float] = (0.0001, 0.0004)
    floor_std_m: float = 0.0004


SETTINGS = DegradationSettings()


def degrade_like_fusion(sample: Sample, random: np.random.Generator) -> StackMaps:
    """Makes a sample's maps as a fused scan might show them."""
    maps, part_length = sample.maps, sample.part_length_m
    # Blur the surface, over what is valid.
    pixel = part_length / PIXELS_PER_LENGTH
    sigma = float(np.hypot(
        random.uniform(*SETTINGS.blur_voxels) * voxel_size_for(part_length**3) / pixel,
        random.uniform(*SETTINGS.resampling_blur_px)))
    inner = maps.top - maps.height
    weight = cv2.GaussianBlur(maps.valid.astype(np.float32), (0, 0), sigma,
                              borderType=cv2.BORDER_CONSTANT)
    top = cv2.GaussianBlur(maps.top, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    top = top / np.maximum(weight, 1e-3)
    # Add noise as smooth as the surface.
    noise = cv2.GaussianBlur(random.standard_normal(top.shape).astype(np.float32), (0, 0),
                             max(sigma, 0.5))
    top += random.uniform(*SETTINGS.noise_m) / part_length * noise / max(float(noise.std()), 1e-6)
    # Move the floor.
    inner = inner + random.normal(0, SETTINGS.floor_std_m) / part_length
    height = np.where(maps.valid, np.maximum(top - inner, 0), 0).astype(np.float32)
    return StackMaps(np.where(maps.valid, top, 0).astype(np.float32), height, maps.valid,
                     maps.wall)


def main() -> int:
    """Prints the textures of fused scans over those of the same scenes degraded, and as cast."""
    from stack_counter.train.data.fused import read_scans
    from stack_counter.train.data.heights import load_samples

    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", type=Path)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--cache", type=Path, default=Path("out/heights"))
    options = parser.parse_args()
    # Features of each scene as fused, degraded and cast.
    cast_by_name = {s.name: s for s in load_samples(options.scenes, options.cache, 2)}
    random, rows, part_lengths = np.random.default_rng(0), [], []
    for scan in read_scans(options.scans):
        if scan.found and scan.sample.name in cast_by_name:
            cast = cast_by_name[scan.sample.name]
            rows.append(np.stack([surface_features(m) for m in (
                scan.sample.maps, degrade_like_fusion(cast, random), cast.maps)]))
            part_lengths.append(cast.part_length_m)
    # Their ratios, for small and for large parts.
    ratio = np.exp(np.array(rows)[:, :1] - np.array(rows)[:, 1:])  # (n, degraded | cast, 6)
    small = np.array(part_lengths) < np.median(part_lengths)
    print(f"{len(rows)} scans; fused over degraded, fused over as cast: median and quartiles")
    for name, chosen in (("small parts", small), ("large parts", ~small)):
        for i, feature in enumerate(_FEATURES):
            quartiles = np.percentile(ratio[chosen][:, :, i], [50, 25, 75], axis=0).T
            print(f"{name:12}{feature:12}" + "   ".join("{:.3f} ({:.3f} {:.3f})".format(*q)
                                                        for q in quartiles))
    return 0


if __name__ == "__main__":
    sys.exit(main())
