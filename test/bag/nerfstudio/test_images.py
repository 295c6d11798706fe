# SPDX-License-Identifier: Apache-2.0
"""Files of a scene: names, units of depth, masks, cutouts."""

import cv2
import numpy as np
import pytest
from kits.memory import limited_memory
from PIL import Image

from stack_counter.bag.nerfstudio.images import (
    find_file,
    masks_are_labels,
    read_cutouts,
    read_depth,
    read_jpeg,
    read_mask,
)
from stack_counter.errors import BagError

SIZE = (8, 6)


def saved(path, pixels):
    if path.suffix == ".npy":
        np.save(path, pixels)
    else:
        cv2.imwrite(str(path), pixels)
    return path


@pytest.mark.parametrize("name", ["images/a.b.jpg", "images/a.b", "images/a.b.png",
                                  "./images/a.b.JPEG", "images\\a.b.jpg"])
def test_files_are_found_by_their_names_without_or_with_another_suffix(tmp_path, name):
    (tmp_path / "images").mkdir()
    path = saved(tmp_path / "images/a.b.jpg", np.zeros((6, 8, 3), np.uint8))
    found = find_file(tmp_path, name, (".png", ".jpg"))
    assert found is not None and found.samefile(path)
    assert find_file(tmp_path, "images/other.jpg", (".png", ".jpg")) is None


def test_a_jpeg_is_told_by_its_content(tmp_path):
    path = saved(tmp_path / "a.jpg", np.full((6, 8, 3), 100, np.uint8)).rename(tmp_path / "a.png")
    assert read_jpeg(path) == (path.read_bytes(), SIZE)
    (tmp_path / "b.png").write_bytes(b"no picture")
    with pytest.raises(BagError, match="b.png does not decode"):
        read_jpeg(tmp_path / "b.png")


def test_exif_turns_a_picture_only_to_the_size_that_is_stated(tmp_path):
    pixels = np.zeros((60, 80, 3), np.uint8)
    pixels[:20, :20] = 200  # upper left
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned to the right
    path = tmp_path / "a.jpg"
    Image.fromarray(np.ascontiguousarray(np.rot90(pixels))).save(path, exif=exif)
    for stated in (None, (60, 80), (1, 2)):
        assert read_jpeg(path, stated) == (path.read_bytes(), (60, 80))
    content, size = read_jpeg(path, (80, 60))
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert size == (80, 60) and np.abs(image.astype(int) - pixels).mean() < 3


@pytest.mark.parametrize("name, values, unit", [
    ("d.png", np.uint16(500), None), ("d.npy", np.float32(0.5), None),
    ("d.npy", np.float32(500), None), ("d.npy", np.uint16(500), None),
    ("d.tiff", np.float32(0.5), None), ("d.png", np.uint16(5000), 1e-4)])
def test_depth_is_in_metres_whatever_its_file(tmp_path, name, values, unit):
    pixels = np.full((6, 8), values)
    pixels[0, 0] = 0
    if pixels.dtype == np.float32:
        pixels[0, 1] = np.nan
    depth = read_depth(saved(tmp_path / name, pixels), SIZE, unit)
    assert depth.dtype == np.float32 and depth[0, 0] == 0
    assert np.allclose(depth[1:], 0.5) and np.isfinite(depth).all()


def test_depth_of_a_phone_is_enlarged_to_its_picture(tmp_path):
    small = np.arange(500, 512, dtype=np.uint16).reshape(3, 4)
    depth = read_depth(saved(tmp_path / "d.png", small), SIZE, None)
    assert np.allclose(depth, np.kron(small, np.ones((2, 2))) / 1000)


@pytest.mark.parametrize("name, pixels, unit, said", [
    ("d.png", np.full((6, 8), 5, np.uint16), None, "0.005 m in the middle.*depth_unit_scale"),
    ("d.png", np.full((6, 8), 500, np.uint16), 1.0, "500 m in the middle"),
    ("d.png", np.full((6, 8), 99, np.uint8), None, "holds uint8"),
    ("d.png", np.full((6, 8, 3), 99, np.uint16), None, "expected one channel"),
    ("d.png", np.full((8, 6), 500, np.uint16), None, "is 6x8 and its picture 8x6"),
    ("d.npy", np.array(["a"]), None, "holds <U1")])
def test_bad_depth_is_named(tmp_path, name, pixels, unit, said):
    with pytest.raises(BagError, match=said):
        read_depth(saved(tmp_path / name, pixels), SIZE, unit)


@pytest.mark.parametrize("name, high", [("m.png", 255), ("m.png", 1), ("m.jpg", 255)])
def test_black_is_masked_out(tmp_path, name, high):
    pixels = np.full((16, 16), high, np.uint8)
    pixels[:8] = 0
    mask = read_mask(saved(tmp_path / name, pixels), (16, 16))
    assert not mask[:8].any() and mask[8:].all()
    assert not masks_are_labels([tmp_path / name])


def test_images_of_labels_are_told_from_masks_by_all_of_them(tmp_path):
    paths = [saved(tmp_path / f"{i}.png", np.full((6, 8), i, np.uint8)) for i in range(3)]
    assert masks_are_labels(paths) and not masks_are_labels(paths[:2])


def test_cutouts_give_labels_and_must_have_an_alpha_channel(tmp_path):
    both = np.zeros((6, 8, 4), np.uint8)
    both[:, :6, 3] = 255
    parts = both.copy()
    parts[:, 3:, 3] = 0
    paths = saved(tmp_path / "obj.png", parts), saved(tmp_path / "box.png", both)
    assert read_cutouts(*paths, SIZE)[0].tolist() == [2, 2, 2, 1, 1, 1, 0, 0]
    assert read_cutouts(paths[0], None, SIZE)[0].tolist() == [2, 2, 2, 0, 0, 0, 0, 0]
    with pytest.raises(BagError, match="no alpha channel"):
        read_cutouts(saved(tmp_path / "plain.png", both[..., :3]), None, SIZE)
    with pytest.raises(BagError, match="8x6 and its picture 4x4"):
        read_cutouts(paths[0], None, (4, 4))


def test_an_array_that_states_more_than_it_holds_is_refused(tmp_path):
    path = tmp_path / "d.npy"
    np.save(path, np.zeros((6, 8), np.float32))
    path.write_bytes(path.read_bytes().replace(b"(6, 8), }      ", b"(60000, 80000)}"))
    with limited_memory(), pytest.raises(BagError, match="d.npy does not decode"):
        read_depth(path, SIZE, None)
