# SPDX-License-Identifier: Apache-2.0
"""What fusion adds to a surface that an arc of views sees: blur, noise and a floor out of place.

The blur of the TSDF and of the depth's smoothing goes with the voxel, the noise with the camera.
The sizes are such that degraded maps agree with truly fused ones of the same scenes:
`python -m stack_counter.train.data.degrade RECORDINGS data/train-deep` prints both.
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


@dataclass(frozen=True)
class DegradeSettings:
    """What fusion does to an ideal surface; this module's command compares it with fused maps.

    Attributes:
        blur_voxels: bounds of the standard deviation of fusion's blur, voxels.
        resampling_px: bounds of that of bringing the map to the network's pixels, pixels.
        noise_m: bounds of the standard deviation of the fused surface, metres.
        floor_m: standard deviation of the inner surface's level, metres.
    """

    blur_voxels: tuple[float, float] = (0.4, 0.65)
    resampling_px: tuple[float, float] = (0.2, 0.55)
    noise_m: tuple[float, float] = (0.0001, 0.0004)
    floor_m: float = 0.0004


SETTINGS = DegradeSettings()


def degrade_like_fusion(sample: Sample, random: np.random.Generator) -> StackMaps:
    """Degrades the sample's maps to what a fused scan might show."""
    maps, length = sample.maps, sample.length_m
    pixel = length / PIXELS_PER_LENGTH
    sigma = float(
        np.hypot(
            random.uniform(*SETTINGS.blur_voxels) * voxel_size_for(sample.length_m**3) / pixel,
            random.uniform(*SETTINGS.resampling_px),
        )
    )
    inner = maps.top - maps.height
    weight = cv2.GaussianBlur(maps.valid.astype(np.float32), (0, 0), sigma,
                              borderType=cv2.BORDER_CONSTANT)
    top = cv2.GaussianBlur(maps.top, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    top = top / np.maximum(weight, 1e-3)
    noise = cv2.GaussianBlur(random.standard_normal(top.shape).astype(np.float32), (0, 0),
                             max(sigma, 0.5))
    top += random.uniform(*SETTINGS.noise_m) / length * noise / max(float(noise.std()), 1e-6)
    inner = inner + random.normal(0, SETTINGS.floor_m) / length
    height = np.where(maps.valid, np.maximum(top - inner, 0), 0).astype(np.float32)
    return StackMaps(np.where(maps.valid, top, 0).astype(np.float32), height, maps.valid,
                     maps.wall)


def main() -> int:
    """Prints the textures of fused scans over those of the same scenes degraded."""
    from stack_counter.train.data.fused import read_scans
    from stack_counter.train.data.heights import load_samples

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scans", type=Path)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--cache", type=Path, default=Path("out/heights"))
    options = parser.parse_args()
    by_name = {s.name: s for s in load_samples(options.scenes, options.cache, 2)}
    random, rows, lengths = np.random.default_rng(0), [], []
    for scan in read_scans(options.scans):
        if scan.found and scan.sample.name in by_name:
            twin = by_name[scan.sample.name]
            rows.append(np.stack([surface_features(m) for m in (
                scan.sample.maps, degrade_like_fusion(twin, random), twin.maps)]))
            lengths.append(twin.length_m)
    ratio = np.exp(np.array(rows)[:, :1] - np.array(rows)[:, 1:])  # (n, degraded | cast, 6)
    small = np.array(lengths) < np.median(lengths)
    print(f"{len(rows)} scans; fused over degraded, fused over as cast: median and quartiles")
    for name, pick in (("small parts", small), ("large parts", ~small)):
        for i, what in enumerate(("height", "side", "V", "unevenness", "step", "bend")):
            q = np.percentile(ratio[pick][:, :, i], [50, 25, 75], axis=0).T
            print(f"{name:12}{what:12}" + "   ".join("{:.3f} ({:.3f} {:.3f})".format(*x)
                                                     for x in q))
    return 0


if __name__ == "__main__":
    sys.exit(main())
