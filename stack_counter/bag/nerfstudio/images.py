# SPDX-License-Identifier: Apache-2.0
"""The image files of a scene: pictures, depth, masks and labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stack_counter.errors import BagError
from stack_counter.images import decode_image
from stack_counter.types import CONTAINER, PARTS

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
DEPTH_SUFFIXES = (".png", ".npy", ".tif", ".tiff")
_JPEG_HEAD = b"\xff\xd8"


@dataclass(frozen=True)
class ImageSettings:
    """How images are read.

    Attributes:
        jpeg_quality: of pictures that are no JPEG files; chosen.
        mm: metres in one step of depth in whole numbers, as nerfstudio takes it (its
            `depth_unit_scale_factor`).
        farthest_m: depth in fractions whose middle value is larger is in millimetres, not metres;
            chosen: no bin is seen from so far, and no camera sees from so near.
        nearest_m: a middle value below this is another unit; chosen.
    """

    jpeg_quality: int = 95
    mm: float = 1e-3
    farthest_m: float = 20.0
    nearest_m: float = 0.02


SETTINGS = ImageSettings()


def find_file(scene: Path, name: str, suffixes: tuple[str, ...]) -> Path | None:
    """Finds a file by the name that transforms.json has for it.

    Args:
        scene: folder that names are relative to.
        name: as it stands there, also without a suffix or with another one.
        suffixes: those that are looked for, the best one first.

    Returns:
        Its path; None where it is not there.
    """
    path = scene / name.replace("\\", "/")
    if path.is_file():
        return path
    spelled = [form for suffix in suffixes for form in (suffix, suffix.upper())]
    others = (path.parent / f"{stem}{suffix}" for stem in (path.name, path.stem)
              for suffix in spelled)
    return next((other for other in others if other.is_file()), None)


def read_jpeg(path: Path, stated: tuple[int, int] | None = None
              ) -> tuple[bytes, tuple[int, int]]:
    """Reads a picture: a JPEG file as it is, another one as what it is as a JPEG.

    An EXIF orientation does not count, as the calibration is that of the pixels as stored, unless
    the size stated is that of the picture when turned by it.

    Args:
        path: of the picture.
        stated: width and height that the calibration is for, pixels; None where it does not say.

    Returns:
        The content, and width and height, pixels.

    Raises:
        BagError: it does not decode.
    """
    content = path.read_bytes()
    image = _decode(path, content, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    is_turned = stated == image.shape[:2] and image.shape[0] != image.shape[1]
    if is_turned:
        image = _decode(path, content, cv2.IMREAD_COLOR)
    if is_turned or not content.startswith(_JPEG_HEAD):
        options = [cv2.IMWRITE_JPEG_QUALITY, SETTINGS.jpeg_quality]
        content = cv2.imencode(".jpg", image, options)[1].tobytes()
    return content, (image.shape[1], image.shape[0])


def _decode(path: Path, content: bytes, how: int) -> np.ndarray:
    """(h, w, 3) uint8 BGR of a picture file's content. Raises BagError: it does not decode."""
    image = decode_image(content, how)
    if image is None:
        raise BagError(f"{path} does not decode; expected a picture of "
                       f"{', '.join(PICTURE_SUFFIXES)}: convert it")
    return image


def read_depth(path: Path, size: tuple[int, int], unit: float | None) -> np.ndarray:
    """Reads a depth image: whole numbers are millimetres, fractions millimetres or metres.

    Args:
        path: 16-bit or float image, or array of numpy.
        size: width and height of the picture, pixels; another one is scaled to it.
        unit: metres in one step; None: as above.

    Returns:
        (h, w) float32 metres along the optical axis, 0 where unknown.

    Raises:
        BagError: it does not decode, is no depth, or lies out of reach.
    """
    raw = _read_numbers(path)
    image = np.where(np.isfinite(raw) & (raw > 0), raw, 0).astype(np.float32)
    if image.any():
        middle = float(np.median(image[image > 0]))
        if unit is None:
            whole = np.issubdtype(raw.dtype, np.integer)
            unit = SETTINGS.mm if whole or middle > SETTINGS.farthest_m else 1.0
        if not SETTINGS.nearest_m <= middle * unit <= SETTINGS.farthest_m:
            raise BagError(f"{path}: the depth is {middle * unit:.3g} m in the middle; expected "
                           f"{SETTINGS.nearest_m} to {SETTINGS.farthest_m}: set "
                           "depth_unit_scale_factor in transforms.json, metres in one step of it")
        image *= np.float32(unit)
    if image.shape == (size[1], size[0]):
        return image
    if abs(image.shape[1] * size[1] - image.shape[0] * size[0]) > max(size):
        raise BagError(f"{path} is {image.shape[1]}x{image.shape[0]} and its picture "
                       f"{size[0]}x{size[1]}; expected the same size or shape")
    return cv2.resize(image, size, interpolation=cv2.INTER_NEAREST_EXACT)


def _read_numbers(path: Path) -> np.ndarray:
    """(h, w) numbers of a depth image as they are stored.

    Raises:
        BagError: it does not decode, or is no depth.
    """
    raw: np.ndarray | None
    if path.suffix.lower() == ".npy":
        try:
            # Mapped: of an array that states more than it holds nothing is made room for.
            raw = np.squeeze(np.array(np.load(path, "r", allow_pickle=False)))
        except (ValueError, OSError, EOFError, OverflowError) as error:
            raise BagError(f"{path} does not decode ({error}); expected an array") from error
    else:
        raw = decode_image(path.read_bytes(), cv2.IMREAD_UNCHANGED)
        if raw is None:
            raise BagError(f"{path} does not decode; expected a depth image")
    if raw.ndim != 2 or raw.dtype == np.uint8 or not np.issubdtype(raw.dtype, np.number):
        raise BagError(f"{path} holds {raw.dtype} of shape {raw.shape}; expected one channel of "
                       "16-bit millimetres or of float")
    return raw


def read_grey(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w) uint8 grey levels of a mask or label image.

    Args:
        path: image file.
        size: width and height of its picture, pixels.

    Raises:
        BagError: it does not decode, or is of another size.
    """
    return _of_size(path, decode_image(path.read_bytes(), cv2.IMREAD_GRAYSCALE
                                       | cv2.IMREAD_IGNORE_ORIENTATION), size)


def read_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w) bool of nerfstudio's mask: False where the picture is to be ignored.

    Raises:
        BagError: it does not decode, or is of another size.
    """
    grey = read_grey(path, size)
    return grey > (127 if grey.max() > 1 else 0)  # a JPEG's black is not quite 0


def masks_are_labels(paths: list[Path]) -> bool:
    """Whether images hold labels 0, 1 and 2, some of them parts, and not masks of 0 and 255."""
    highest = 0
    for path in paths:
        grey = decode_image(path.read_bytes(), cv2.IMREAD_GRAYSCALE)
        highest = max(highest, 0 if grey is None else int(grey.max()))
    return highest == PARTS


def read_cutouts(parts: Path, container: Path | None, size: tuple[int, int]) -> np.ndarray:
    """(h, w) uint8 label image of two pictures whose background is transparent.

    Args:
        parts: picture of the parts alone.
        container: picture of the container with the parts; None where there is none.
        size: width and height, pixels.

    Raises:
        BagError: one does not decode, has no alpha channel or is of another size.
    """
    labels = np.zeros((size[1], size[0]), np.uint8)
    for path, label in ((container, CONTAINER), (parts, PARTS)):
        if path is None:
            continue
        image = _of_size(path, decode_image(path.read_bytes(), cv2.IMREAD_UNCHANGED), size)
        if image.ndim != 3 or image.shape[2] != 4:
            raise BagError(f"{path} has no alpha channel; expected one that shows the parts")
        labels[image[..., 3] > np.iinfo(image.dtype).max // 2] = label
    return labels


def _of_size(path: Path, image: np.ndarray | None, size: tuple[int, int]) -> np.ndarray:
    if image is None:
        raise BagError(f"{path} does not decode; expected an image")
    if image.shape[:2] != (size[1], size[0]):
        raise BagError(f"{path} is {image.shape[1]}x{image.shape[0]} and its picture "
                       f"{size[0]}x{size[1]}; expected alike")
    return image
