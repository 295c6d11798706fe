# SPDX-License-Identifier: Apache-2.0
"""The model of what stereo does to a surface: made pairs, the fit, and the check.

    python -m stack_counter.train.stereo_surface pairs OUT data/train-deep:9 data/train-compound:9
    python -m stack_counter.train.stereo_surface fit OUT
    python -m stack_counter.train.stereo_surface check OUT

`pairs` records pictures of every n-th scene and runs the stereo, about a minute each, and goes on
where it stopped. `fit` prints the settings of `train.data.stereo_surface`; `check` how often a
small classifier tells degraded surfaces from reconstructed ones, and how often with the noise of
fusion alone.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from scipy import optimize

from stack_counter.errors import StackCounterError
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, network_channels
from stack_counter.reconstruction.integral import fill_unknown_cells
from stack_counter.sim import Scene, read_scenes, reconstruct_from_pictures
from stack_counter.train.data.degrade import degrade_like_fusion
from stack_counter.train.data.heights import Sample
from stack_counter.train.data.stereo_surface import SETTINGS as SHIPPED
from stack_counter.train.data.stereo_surface import (
    StereoSurfaceSettings,
    draw_model,
    stereo_surface,
)
from stack_counter.train.data.surface_pairs import (
    SurfacePair,
    make_pair,
    read_pairs,
    write_pairs,
)
from stack_counter.train.data.surface_patches import classify, inside, patches_of


@dataclass(frozen=True)
class FitSettings:
    """How pairs are made and the model is fitted; all chosen.

    Attributes:
        widths_px: widths of the pictures, in turn.
        largest_error: median distance of the two surfaces, part lengths, above which a pair is
            left out: its container was not found for what it is.
        fewest_cells: cells of a pair that is used.
        band_px: standard deviations of the blurs between which the power of a band lies, pixels.
        shares: of the quantiles of height, slope and bend that are compared, percent.
        paired_weight: weight of the distance of the two surfaces beside that of the statistics.
        evaluations: of the model over all pairs.
    """

    widths_px: tuple[int, ...] = (640, 480, 640, 320)
    largest_error: float = 0.15
    fewest_cells: int = 400
    band_px: tuple[float, ...] = (0.7, 1.4, 2.8, 5.6, 11.2)
    shares: tuple[float, ...] = (2, 10, 25, 50, 75, 90, 98)
    paired_weight: float = 0.5
    evaluations: int = 160


SETTINGS = FitSettings()


def main() -> int:
    """Makes pairs, fits the model to them, or checks it."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("pairs")
    make.add_argument("folder", type=Path)
    make.add_argument("scenes", nargs="+", metavar="DIR:STEP")
    for name in ("fit", "check"):
        commands.add_parser(name).add_argument("folder", type=Path)
    options = parser.parse_args()
    if options.command == "pairs":
        _make_pairs(options.folder, options.scenes)
        return 0
    pairs = [pair for pair in read_pairs(options.folder) if _is_usable(pair)]
    if options.command == "fit":
        targets = [target_of(pair) for pair in pairs]
        fitted = fit(targets)
        for field, value in zip(fields(fitted), astuple(fitted)):
            print(f"    {field.name}: float = {value:.3g}")
        print(f"{len(pairs)} pairs; distance {mean_distance(fitted, targets):.3f}, "
              f"of the settings so far {mean_distance(SHIPPED, targets):.3f}")
        return 0
    print_check(pairs)
    return 0


def _make_pairs(folder: Path, texts: list[str]) -> None:
    """Makes the pairs of every n-th scene that are not in the folder yet."""
    folder.mkdir(parents=True, exist_ok=True)
    number = 0
    for text in texts:
        scenes, _, step = text.rpartition(":")
        for scene in read_scenes(Path(scenes)):
            if not scene.truth.count or scene.index % int(step):
                continue
            path = folder / f"{Path(scenes).name}_{scene.index:05d}.npz"
            width = SETTINGS.widths_px[number % len(SETTINGS.widths_px)]
            number += 1
            if not path.exists():
                write_pairs(path, make_pairs_of_scene(scene, f"{Path(scenes).name}:{scene.index}",
                                                      width))
                print(path, flush=True)


def make_pairs_of_scene(scene: Scene, name: str, width_px: int) -> list[SurfacePair]:
    """Records a scene and reconstructs it from pictures; none where that is refused."""
    try:
        return [make_pair(scene, reconstruct_from_pictures(scene, width_px=width_px), name)]
    except StackCounterError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return []


@dataclass(frozen=True, eq=False)
class Target:
    """What a degraded surface is compared with.

    Attributes:
        pair: of which it is.
        usable: (rows, cols) bool, where it is compared.
        local: (rows, cols) float32 reconstructed heights over their surroundings, part lengths.
        statistics: of the reconstructed surface.
    """

    pair: SurfacePair
    usable: np.ndarray
    local: np.ndarray
    statistics: np.ndarray


def target_of(pair: SurfacePair) -> Target:
    """Measures the reconstructed surface of a pair."""
    usable, local = inside(pair), local_heights(pair, pair.top)
    return Target(pair, usable, local, surface_statistics(pair, pair.top, local, usable))


def fit(targets: list[Target]) -> StereoSurfaceSettings:
    """Fits the model by the simplex method of Nelder and Mead."""
    start = np.array(astuple(SHIPPED))
    corners = np.vstack([start, start * (1 + 0.4 * np.eye(len(start)))])
    found = optimize.minimize(
        lambda x: mean_distance(StereoSurfaceSettings(*np.abs(x)), targets), start,
        method="Nelder-Mead",
        options={"maxfev": SETTINGS.evaluations, "initial_simplex": corners})
    return StereoSurfaceSettings(*map(float, np.abs(found.x)))


def mean_distance(model: StereoSurfaceSettings, targets: list[Target]) -> float:
    """Mean distance of degraded surfaces from reconstructed ones, by statistics and by place."""
    distances = []
    for i, target in enumerate(targets):
        top = _degrade(target.pair, np.random.default_rng(i), model)
        local = local_heights(target.pair, top)
        off = surface_statistics(target.pair, top, local, target.usable) - target.statistics
        apart = np.minimum(np.abs(local - target.local)[target.usable], 1)
        distances.append(np.mean(np.minimum(off**2, 4))
                         + SETTINGS.paired_weight * np.mean(apart))
    return float(np.mean(distances))


def local_heights(pair: SurfacePair, top: np.ndarray) -> np.ndarray:
    """(rows, cols) float32 heights over their surroundings, part lengths."""
    return network_channels(pair.maps(top))[0]


def surface_statistics(pair: SurfacePair, top: np.ndarray, local: np.ndarray,
                       usable: np.ndarray) -> np.ndarray:
    """Logs of band powers and of slopes; quantiles of heights and bends; about alike in scale."""
    valid, shares = pair.valid.astype(np.float32), SETTINGS.shares
    top = np.where(pair.valid, top, 0).astype(np.float32)
    # Powers between one blur and the next.
    powers, before = [], top
    for sigma in SETTINGS.band_px:
        blurred = cv2.GaussianBlur(top, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        weight = cv2.GaussianBlur(valid, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        blurred /= np.maximum(weight, 1e-3)
        powers.append((before - blurred)[usable].std())
        before = blurred
    # Heights over the surroundings, slopes and bends.
    dy, dx = np.gradient(top)
    slopes = PIXELS_PER_LENGTH * np.hypot(dy, dx)[usable]
    bends = cv2.Laplacian(top, cv2.CV_32F)[usable]
    return np.concatenate([
        2 * np.log(np.array(powers) + 0.01), 2 * np.percentile(local[usable], shares),
        3 * np.log(np.percentile(slopes, shares[1:]) + 0.05),
        4 * np.percentile(bends, shares[::2])])


def print_check(pairs: list[SurfacePair]) -> None:
    """Prints how often the classifier is right, with the model and with fusion's noise alone."""
    for title, degrade in (("as stereo", _degrade_as_drawn),
                           ("as fusion", _degrade_as_fusion)):
        items = patches_of(pairs, degrade)
        shares = np.array(classify(items))
        counts = np.array([len(item.true) for item in items])
        judged = np.isfinite(shares)
        print(f"degraded {title}: {shares[judged] @ counts[judged] / counts[judged].sum():.1%} "
              f"of the patches told right; {np.count_nonzero(judged)} pairs, "
              f"{counts[judged].sum()} patches")
        for pair, share, count in zip(pairs, shares, counts):
            print(f"    {pair.name:24}{pair.family:24}{pair.resolution:.3f}{share:8.0%} of "
                  f"{count}")


def _degrade(pair: SurfacePair, random: np.random.Generator,
             model: StereoSurfaceSettings = SHIPPED) -> np.ndarray:
    """The cast surface of a pair as the model of stereo has it."""
    return stereo_surface(pair.cast, pair.seen_share, pair.valid, pair.resolution, random, model)


def _degrade_as_drawn(pair: SurfacePair, random: np.random.Generator) -> np.ndarray:
    """The cast surface of a pair as it is learnt from: by the model of some scan."""
    return _degrade(pair, random, draw_model(random))


def _degrade_as_fusion(pair: SurfacePair, random: np.random.Generator) -> np.ndarray:
    """The cast surface of a pair as learnt from for depth cameras."""
    seen = pair.valid & (pair.seen_share > 0)
    top = fill_unknown_cells(np.where(seen, pair.cast, np.nan), seen)
    sample = Sample(pair.maps(top), 0.0, np.zeros(3, np.float32), pair.part_length_m, pair.name,
                    pair.family, "", 0, 0.0)
    return degrade_like_fusion(sample, random).top


def _is_usable(pair: SurfacePair) -> bool:
    """Whether enough of a pair is well inside, and shows the same place twice."""
    usable = inside(pair)
    return bool(np.count_nonzero(usable) >= SETTINGS.fewest_cells and np.median(
        np.abs(pair.top - pair.cast)[usable]) < SETTINGS.largest_error)


if __name__ == "__main__":
    sys.exit(main())
