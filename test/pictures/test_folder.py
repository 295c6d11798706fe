# SPDX-License-Identifier: Apache-2.0
"""Pictures of a folder: EXIF rotation and focal length, HEIC, label images, damaged files."""

import numpy as np
import pytest
from PIL import Image

from stack_counter.errors import BagError
from stack_counter.pictures.folder import find_pictures, read_jpeg, read_labels, read_pixels

PIXELS = np.zeros((30, 40, 3), np.uint8)
PIXELS[:10, :10] = 200  # upper left


def save(path, pixels=PIXELS, orientation=1, focal_mm=0):
    """Saves pixels so that they look as given when turned by the EXIF orientation."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    exif.get_ifd(0x8769)[0xA405] = focal_mm
    stored = np.rot90(pixels) if orientation == 6 else pixels  # 6: to be turned to the right
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(np.ascontiguousarray(stored)).save(path, exif=exif, quality=95)


@pytest.mark.parametrize("name, orientation", [("a.jpg", 6), ("a.png", 6), ("a.heic", 1)])
def test_pictures_are_upright(tmp_path, name, orientation):
    from pillow_heif import register_heif_opener
    register_heif_opener()
    save(tmp_path / name, orientation=orientation, focal_mm=27)
    (picture,) = find_pictures(tmp_path)
    assert (picture.name, picture.width, picture.height) == (name, 40, 30)
    assert picture.focal_px == pytest.approx(27 / 36 * 40)
    pixels = read_pixels(picture.path)
    assert pixels[5, 5].min() > 150 and pixels[5, 35].max() < 50 and pixels[25, 5].max() < 50
    (tmp_path / "b").mkdir()
    (tmp_path / "b/b.jpg").write_bytes(read_jpeg(picture))
    assert Image.open(tmp_path / "b/b.jpg").getexif().get(0x0112, 1) == 1
    assert read_pixels(tmp_path / "b/b.jpg").shape == (30, 40, 3)


def test_an_upright_jpeg_stays_as_it_is(tmp_path):
    save(tmp_path / "images" / "a.jpg")
    (picture,) = find_pictures(tmp_path)
    assert read_jpeg(picture) == (tmp_path / "images/a.jpg").read_bytes()
    assert picture.focal_px == 0 and read_labels(picture) is None


def test_label_images_must_fit_the_upright_picture(tmp_path):
    save(tmp_path / "a.jpg", orientation=6)
    (tmp_path / "labels").mkdir()
    Image.fromarray(np.full((30, 40), 2, np.uint8)).save(tmp_path / "labels/a.png")
    assert (read_labels(find_pictures(tmp_path)[0]) == 2).all()
    Image.fromarray(np.full((40, 30), 2, np.uint8)).save(tmp_path / "labels/a.png")
    with pytest.raises(BagError, match="is 30x40; expected 40x30 as a.jpg upright"):
        read_labels(find_pictures(tmp_path)[0])


def test_what_is_no_picture_is_left_out_or_named(tmp_path):
    from pillow_heif import register_heif_opener
    register_heif_opener()
    with pytest.raises(FileNotFoundError, match="expected one with pictures"):
        find_pictures(tmp_path / "none")
    with pytest.raises(BagError, match="0 picture files .* expected files of .jpg"):
        find_pictures(tmp_path)
    save(tmp_path / "a.jpg", np.random.default_rng(0).integers(0, 255, (30, 40, 3), np.uint8))
    (tmp_path / "b.jpg").write_bytes((tmp_path / "a.jpg").read_bytes()[:-500])
    save(tmp_path / "c.heic")
    (tmp_path / "c.heic").write_bytes((tmp_path / "c.heic").read_bytes()[:-20])
    (tmp_path / "notes.txt").write_text("no picture")
    assert [picture.name for picture in find_pictures(tmp_path)] == ["a.jpg"]
