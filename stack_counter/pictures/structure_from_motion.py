# SPDX-License-Identifier: Apache-2.0
"""Where pictures were taken from, and with which lens: structure from motion with COLMAP.

SIFT features, no learned ones; all runs on the CPU. Its world has no scale and no up yet.

Source: Schoenberger and Frahm, "Structure-from-Motion Revisited" (2016); Pan et al., "Global
Structure-from-Motion Revisited" (2024).
"""

from __future__ import annotations

import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.errors import BagError, ConfigError
from stack_counter.pictures.folder import Picture
from stack_counter.tasks.progress import progress_bar
from stack_counter.types import Intrinsics

if TYPE_CHECKING:
    import pycolmap

T = TypeVar("T")


@dataclass(frozen=True)
class MotionSettings:
    """How pictures are matched and their poses found.

    Attributes:
        max_side_px: longer side up to which features are looked for at full size, pixels; chosen.
        max_features: most features of a picture; chosen.
        neighbors: pictures before and after each one in the order of names that it is matched
            with first, and those 16, 32, 64 ... away; chosen.
        whole_share: share of the pictures that must register by that, or all pairs are matched;
            chosen.
        min_share: least share of the pictures that must register; chosen.
        min_pictures: fewest of them; chosen, as few as a scan takes.
        default_focal: focal length without EXIF where the search for it begins, longer sides of
            the picture: COLMAP's own.
        batch: pictures, and eight times as many pairs, between two steps of the progress bar;
            chosen.
    """

    max_side_px: int = 1600
    max_features: int = 2048
    neighbors: int = 8
    whole_share: float = 0.9
    min_share: float = 0.6
    min_pictures: int = 3
    default_focal: float = 1.2
    batch: int = 8


SETTINGS = MotionSettings()


@dataclass(frozen=True, eq=False)
class Camera:
    """Calibration of a picture and its pose, (4, 4) float64, in the unit of its world."""

    intrinsics: Intrinsics
    T_world_camera: np.ndarray


@dataclass(frozen=True, eq=False)
class PosedPictures:
    """What structure from motion finds.

    Attributes:
        cameras: of the pictures that registered, by name.
        points: (n, 3) float64 places of the features, in a unit of its own.
        unregistered: names of the other pictures.
    """

    cameras: dict[str, Camera]
    points: np.ndarray
    unregistered: list[str]


def find_poses(pictures: Sequence[Picture], read_gray: Callable[[str], np.ndarray]
               ) -> PosedPictures:
    """Finds poses and calibrations of pictures.

    Args:
        pictures: in the order in which they were taken, if they were taken in one.
        read_gray: gives the (h, w) uint8 grey picture, upright, of a name.

    Raises:
        BagError: too few of them register.
        ConfigError: pycolmap is missing.
    """
    names = [picture.name for picture in pictures]
    with tempfile.TemporaryDirectory(prefix="stack_counter_") as folder:
        motion = _Motion(Path(folder))
        motion.find_features(pictures, read_gray)
        # Match what was taken one after the other; if that leaves pictures out, all with all.
        near = _near_pairs(len(names))
        motion.match([(names[i], names[j]) for i, j in near])
        found = motion.map_pictures(names)
        if len(found.cameras) < SETTINGS.whole_share * len(names):
            rest = sorted(set(combinations(range(len(names)), 2)) - set(near))
            motion.match([(names[i], names[j]) for i, j in rest])
            found = max(found, motion.map_pictures(names), key=lambda f: len(f.cameras))
    share = len(found.cameras) / len(names)
    if share < SETTINGS.min_share or len(found.cameras) < SETTINGS.min_pictures:
        raise BagError(f"{len(found.cameras)} of {len(names)} pictures registered ({share:.0%}); "
                       f"expected {SETTINGS.min_share:.0%} and {SETTINGS.min_pictures} or more: "
                       "take more pictures, sharp and with more overlap, of a scene that stands "
                       "still on a patterned ground; not registered: "
                       f"{listed(found.unregistered)}")
    return found


def listed(names: Sequence[str], most: int = 8) -> str:
    """Names in one line, of many the first ones and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def _batches(items: Sequence[T], size: int) -> Iterator[Sequence[T]]:
    return (items[i:i + size] for i in range(0, len(items), size))


def _near_pairs(count: int) -> list[tuple[int, int]]:
    """Pairs of neighbours in a row of pictures, and of some far apart to close a round."""
    far = [2**k for k in range(count.bit_length()) if 2**k > SETTINGS.neighbors]
    return [(i, i + step) for step in (*range(1, SETTINGS.neighbors + 1), *far)
            for i in range(count - step)]


def _load_colmap() -> ModuleType:
    """Loads pycolmap, quiet and with a fixed seed; what SIGTERM does stays as it was.

    Raises:
        ConfigError: it is missing.
    """
    on_sigterm = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError as error:
        raise ConfigError("pictures without poses take pycolmap; expected "
                          "pip install 'stack_counter[pictures]'") from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, on_sigterm)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    pycolmap.set_random_seed(0)
    return pycolmap


class _Motion:
    """COLMAP's files of one run: grey pictures, features and matches."""

    def __init__(self, folder: Path):
        """Raises ConfigError: pycolmap is missing."""
        self._colmap = _load_colmap()
        self._folder, self._database = folder, folder / "database.db"
        for name in ("gray", "models"):
            (folder / name).mkdir()
        self._files: dict[str, str] = {}  # of the grey pictures, by the picture's name

    def find_features(self, pictures: Sequence[Picture], read_gray: Callable[[str], np.ndarray]
                      ) -> None:
        """Finds features; pictures of one size and focal length share a camera."""
        lenses: dict[tuple[int, int, float], list[Picture]] = {}
        for picture in pictures:
            lens = (picture.width, picture.height, picture.focal_px)
            lenses.setdefault(lens, []).append(picture)
            self._files[picture.name] = f"{len(self._files)}.png"
        reader = self._colmap.ImageReaderOptions()
        extraction = self._colmap.FeatureExtractionOptions()
        extraction.max_image_size = SETTINGS.max_side_px
        extraction.sift.max_num_features = SETTINGS.max_features
        with progress_bar("features", "pictures", len(pictures)) as advance:
            for alike in lenses.values():
                reader.existing_camera_id = self._add_camera(alike[0])
                for batch in _batches(alike, SETTINGS.batch):
                    for picture in batch:
                        cv2.imwrite(str(self._folder / "gray" / self._files[picture.name]),
                                    read_gray(picture.name), [cv2.IMWRITE_PNG_COMPRESSION, 1])
                    self._colmap.extract_features(
                        self._database, self._folder / "gray",
                        [self._files[picture.name] for picture in batch],
                        self._colmap.CameraMode.SINGLE, reader, extraction)
                    advance(len(batch))

    def _add_camera(self, picture: Picture) -> int:
        focal = picture.focal_px or SETTINGS.default_focal * max(picture.width, picture.height)
        camera = self._colmap.Camera.create_from_model_name(0, "OPENCV", focal, picture.width,
                                                            picture.height)
        camera.has_prior_focal_length = picture.focal_px > 0
        with self._colmap.Database.open(self._database) as database:
            return database.write_camera(camera)

    def match(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Matches the features of pairs of pictures."""
        options = self._colmap.ImportedPairingOptions()
        options.match_list_path = self._folder / "pairs.txt"
        with progress_bar("matches", "pairs", len(pairs)) as advance:
            for batch in _batches(pairs, 8 * SETTINGS.batch):
                options.match_list_path.write_text("".join(
                    f"{self._files[first]} {self._files[second]}\n" for first, second in batch))
                self._colmap.match_image_pairs(self._database, pairing_options=options)
                advance(len(batch))

    def map_pictures(self, names: Sequence[str]) -> PosedPictures:
        """Finds the largest set of pictures that fit together."""
        options = self._colmap.GlobalPipelineOptions()
        options.random_seed = 0
        with progress_bar("poses", "steps", 1) as advance:
            models = self._colmap.global_mapping(self._database, self._folder / "gray",
                                                 self._folder / "models", options)
            advance()
        best = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
        if best is None:
            return PosedPictures({}, np.zeros((0, 3)), list(names))
        by_file = {image.name: image for image in best.images.values() if image.has_pose}
        cameras = {name: _camera(best, by_file[self._files[name]]) for name in names
                   if self._files[name] in by_file}
        points = np.array([point.xyz for point in best.points3D.values()]).reshape(-1, 3)
        return PosedPictures(cameras, points, [name for name in names if name not in cameras])


def _camera(model: pycolmap.Reconstruction, image: pycolmap.Image) -> Camera:
    """A camera of COLMAP, whose pixel centres lie on halves, as one of ours."""
    camera = model.cameras[image.camera_id]
    fx, fy, cx, cy, *distortion = (float(value) for value in camera.params)
    intrinsics = Intrinsics(camera.width, camera.height, fx, fy, cx - 0.5, cy - 0.5, "plumb_bob",
                            (*distortion, 0.0))
    T_camera_world = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
    return Camera(intrinsics, geometry.inverse(T_camera_world))
