# SPDX-License-Identifier: Apache-2.0
"""The pictures of a folder, upright as people see them, with what their EXIF says of the lens."""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stack_counter.errors import BagError, ConfigError
from stack_counter.images import decode_image

_LOG = logging.getLogger(__name__)
_HEIF = (".heic", ".heif")
_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", *_HEIF)
# Numbers of the EXIF tags and of the directory that the last one stands in.
_ORIENTATION, _EXIF_DIRECTORY, _FOCAL_LENGTH_35MM = 0x0112, 0x8769, 0xA405


@dataclass(frozen=True)
class FolderSettings:
    """How pictures are read.

    Attributes:
        film_width_mm: longer side of the film that EXIF's equivalent focal lengths are meant for.
        jpeg_quality: of pictures that are no upright JPEG files; chosen.
    """

    film_width_mm: float = 36.0
    jpeg_quality: int = 95


SETTINGS = FolderSettings()


@dataclass(frozen=True)
class Picture:
    """A picture file that can be read.

    Attributes:
        name: the file's name.
        path: of the file.
        width, height: size of the upright picture, pixels.
        upright: the file's pixels need no turning (EXIF orientation 1, or none).
        focal_px: focal length by EXIF, pixels; 0 if it says none.
        labels_path: of its label image; None where there is none.
    """

    name: str
    path: Path
    width: int
    height: int
    upright: bool
    focal_px: float
    labels_path: Path | None


def find_pictures(folder: Path) -> list[Picture]:
    """Finds the pictures of a folder, or else those of its subfolder `images`.

    A file that is no whole picture is named in the log and left out.

    Args:
        folder: label images lie below it, in `labels/NAME.png`.

    Returns:
        The pictures, sorted by name.

    Raises:
        FileNotFoundError: there is no such folder.
        BagError: it has no pictures, or a label image of another size than its picture.
        ConfigError: the libraries that read them are missing.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"no folder {folder}; expected one with pictures")
    paths = list_picture_files(folder)
    pictures = []
    for path in paths:
        try:
            pictures.append(_describe_picture(folder, path))
        except (OSError, ValueError) as error:  # the latter of HEIC that is cut short
            _LOG.warning("%s is no picture that can be read (%s); left out", path, error)
    if not pictures:
        raise BagError(f"{len(paths)} picture files in {folder} and none can be read; expected "
                       f"files of {', '.join(_SUFFIXES)} in it or in {folder / 'images'}")
    return pictures


def list_picture_files(folder: Path) -> list[Path]:
    """Paths of the files in a folder that are named as pictures, or of those in its `images`."""
    def listed(place: Path) -> list[Path]:
        return sorted(path for path in place.glob("*")
                      if path.suffix.lower() in _SUFFIXES and path.is_file())

    return listed(folder) or listed(folder / "images")


def read_pixels(path: Path) -> np.ndarray:
    """Returns the (h, w, 3) uint8 RGB pixels of a picture file, turned upright by its EXIF.

    Raises:
        OSError: it is no whole picture.
        ConfigError: the libraries that read it are missing.
    """
    from PIL import ImageOps

    with _open(path) as image:
        return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))


def read_jpeg(picture: Picture) -> bytes:
    """Content of an upright JPEG file; of another picture, what it is as one.

    Raises:
        OSError: it is no whole picture.
        ConfigError: the libraries that read it are missing.
    """
    if picture.upright and picture.path.suffix.lower() in (".jpg", ".jpeg"):
        return picture.path.read_bytes()
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(read_pixels(picture.path)).save(buffer, "JPEG",
                                                    quality=SETTINGS.jpeg_quality)
    return buffer.getvalue()


def read_labels(picture: Picture) -> np.ndarray | None:
    """(h, w) uint8 label image of a picture; None where it has none.

    Raises:
        BagError: it does not decode, or has another size than the picture.
    """
    if picture.labels_path is None:
        return None
    labels = decode_image(picture.labels_path.read_bytes(), cv2.IMREAD_GRAYSCALE)
    if labels is None:
        raise BagError(f"{picture.labels_path} does not decode; expected a grey label image")
    if labels.shape != (picture.height, picture.width):
        raise BagError(f"label image {picture.labels_path} is {labels.shape[1]}x"
                       f"{labels.shape[0]}; expected {picture.width}x{picture.height} as "
                       f"{picture.name} upright")
    return labels


def _describe_picture(folder: Path, path: Path) -> Picture:
    """Raises OSError or ValueError: it is no whole picture."""
    height, width = read_pixels(path).shape[:2]  # a file that is cut short fails here
    with _open(path) as image:
        exif = image.getexif()
        # What a camera does not know it writes as 0.
        focal_mm = float(exif.get_ifd(_EXIF_DIRECTORY).get(_FOCAL_LENGTH_35MM) or 0)
        upright = exif.get(_ORIENTATION, 1) in (0, 1)
    labels = folder / "labels" / f"{path.stem}.png"
    return Picture(path.name, path, width, height, upright,
                   focal_mm / SETTINGS.film_width_mm * max(width, height),
                   labels if labels.is_file() else None)


def _open(path: Path) -> Any:
    """Opens a picture with Pillow; HEIC by its plug-in.

    Raises:
        OSError: it is no picture.
        ConfigError: the libraries are missing.
    """
    try:
        from PIL import Image

        if path.suffix.lower() in _HEIF:
            import pillow_heif

            pillow_heif.register_heif_opener()
    except ImportError as error:
        raise ConfigError(f"{path.name} takes pillow and pillow-heif to read; expected "
                          "pip install 'stack_counter[pictures]'") from error
    return Image.open(path)
