# SPDX-License-Identifier: Apache-2.0
"""The page of a report: all of the count is on it, it fetches nothing, and all can read it."""

import base64
import hashlib
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from kits.counted_bin import container, counted_bin

from stack_counter.config import Config, ReconstructorConfig
from stack_counter.display.drawings import LABEL_TINTS
from stack_counter.display.page import page as page_module
from stack_counter.display.page import viewer
from stack_counter.display.page.subject import ReportSubject
from stack_counter.display.report import write_report
from stack_counter.types import CONTAINER, PARTS, Container, Mesh, Reason

FOLDER = Path(page_module.__file__).parent
# How those without red, green or blue cones see linear RGB: Machado et al., "A Physiologically-
# based Model for Simulation of Color Vision Deficiency" (2009), severity 1.
BLINDNESS = {
    "red": [[.152286, 1.052583, -.204868], [.114503, .786281, .099216],
            [-.003882, -.048116, 1.051998]],
    "green": [[.367322, .860646, -.227968], [.280085, .672501, .047413],
              [-.011820, .042940, .968881]],
    "blue": [[1.255528, -.076749, -.178779], [-.078411, .930809, .147602],
             [.004733, .691367, .303900]]}


class Outline(HTMLParser):
    """Tags of a page with their attributes, in order, and its text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.words = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.words.append(data)

    def all(self, name):
        return [attributes for tag, attributes in self.tags if tag == name]


def written(folder, count, **subject):
    """The text of the page that is written of a count."""
    write_report(folder, count, [], ReportSubject(**subject))
    return (folder / "report.html").read_text()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return written(tmp_path_factory.mktemp("report"), counted_bin(), scan="bin 7", part="nut",
                   verdict="fail", expected="expected 120 ± 2", true_count=101,
                   settings=vars(Config(reconstructor=ReconstructorConfig(min_views=5))))


def test_the_page_says_all_of_the_count(page):
    count, text = counted_bin(), " ".join(" ".join(Outline(page).words).split())
    low, high = count.count_interval
    for words in ("100 parts", f"90% sure: {low} to {high}", "✕ Fail", "expected 120 ± 2", "✓ OK",
                  "Really there: 101", "= 0.400 · 3000.0 cm³ / 12 cm³", Reason.ONE_SIDE.sentence,
                  "11 of 14", "blurred: 2", "no tf: 1", "V = 3000.0 ± 60.0 cm³", "seen 2400 cm³",
                  "filled in, unseen 400 cm³", "beside the wall 200 cm³", "γ = 0.400 ± 0.020",
                  "network 25%", "counted bins of the part (3) 75%", "300 × 200 × 100 mm",
                  "50% (lowest 0%, highest 100%)", "fusing views 1.50 s", "2023-11-14 22:13:20",
                  "reconstructor min_views 5", "bin 7", "100 mm"):
        assert words in text, words
    assert len(page) < 4e6


def test_nothing_is_fetched_and_no_other_script_runs(page):
    outline = Outline(page)
    policy = next(meta["content"] for meta in outline.all("meta")
                  if meta.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'; ") and "http" not in policy
    assert "connect-src data:;" in policy and "unsafe-inline'" not in policy.split("style-src")[0]
    for script in re.findall(r"<script>(.*?)</script>", page, re.DOTALL):
        found = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{found}'" in policy
    for _, attributes in outline.tags:
        for name in ("src", "href"):
            assert re.match(r"data:|surface\.|result\.|\w+\.png$|url\(#|$",
                            attributes.get(name, "")), attributes
    evil = "\"><script>alert(1)</script>"
    assert evil not in page_module.render_page(counted_bin(), ReportSubject(evil, evil), b"", "",
                                               [])


def test_the_viewer_is_the_one_that_its_folder_names():
    folder = FOLDER / "model_viewer"
    data = (folder / "model-viewer-umd.min.js").read_bytes()
    assert hashlib.sha256(data).hexdigest() == viewer.VIEWER_SHA256
    assert "</script" not in data.decode().lower()
    about = (folder / "README.md").read_text()
    assert viewer.VIEWER_SHA256 in about and viewer.VIEWER_VERSION in about
    assert "Apache License" in (folder / "LICENSE").read_text()


def test_pictures_have_words_and_headings_an_order(page):
    outline = Outline(page)
    assert all(image.get("alt") for image in outline.all("img"))
    assert all(figure.get("aria-label") for figure in outline.all("svg"))
    levels = [int(tag[1]) for tag, _ in outline.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after <= before + 1 for before, after in zip(levels, levels[1:]))
    ids = [attributes["id"] for _, attributes in outline.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {label["for"] for label in outline.all("label")} <= set(ids)
    assert outline.all("html")[0]["lang"] == "en"


def luminance(color):
    """Relative luminance of a CSS colour (WCAG 2.2)."""
    digits = color.lstrip("#")
    digits = "".join(d * 2 for d in digits) if len(digits) == 3 else digits
    srgb = np.array([int(digits[i:i + 2], 16) for i in (0, 2, 4)]) / 255
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4) \
        @ [0.2126, 0.7152, 0.0722]


def contrast(first, second):
    low, high = sorted((luminance(first), luminance(second)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", [0, 1, 2], ids=["light", "dark", "print"])
def test_words_stand_out_from_their_ground(scheme):
    blocks = re.findall(r":root \{(.*?)\}", (FOLDER / "report.css").read_text(), re.DOTALL)
    colors = {}
    for block in (blocks[0], blocks[scheme]):
        colors |= dict(re.findall(r"--([\w-]+): (#\w+)", block))
    for ink, ground in (("ink", "card"), ("ink", "ground"), ("soft", "card"), ("soft", "ground"),
                        ("accent", "card"), ("accent", "ground"), ("good", "good-ground"),
                        ("bad", "bad-ground")):
        assert contrast(colors[ink], colors[ground]) >= 4.5, (ink, ground)
    for ink in ("s0", "s1"):  # surfaces of a chart (WCAG asks for 3 to 1) against text's ground
        assert contrast(colors[ink], colors["card"]) >= 2, ink


def test_levels_stand_out_from_the_colour_of_their_cell(page):
    cells = re.findall(r"background:(#\w+);color:(#\w+)", page)
    assert len(cells) == 40
    assert min(contrast(*cell) for cell in cells) >= 4.5


@pytest.mark.parametrize("missing", BLINDNESS)
def test_maps_and_tints_can_be_told_apart_without_some_cones(missing):
    """Along the map brightness rises; parts and container differ as much as a third of it."""
    def seen(bgr):
        srgb = np.asarray(bgr, float)[..., ::-1] / 255
        linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        return np.clip(linear @ np.transpose(BLINDNESS[missing]), 0, 1)

    steps = np.linspace(0, 255, 9).astype(np.uint8)[:, None]
    lightness = np.cbrt(seen(cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)[:, 0])
                        @ [0.2126, 0.7152, 0.0722])
    assert (np.diff(lightness) > 0.02).all()
    parts, bin_ = (np.cbrt(seen(LABEL_TINTS[label])) for label in (PARTS, CONTAINER))
    assert np.linalg.norm(parts - bin_) > 0.3


def test_a_count_that_came_by_message_has_a_model_of_its_top_surface(tmp_path):
    """Messages carry no mesh, no wall, no parts of V and no distribution."""
    count = counted_bin(mesh=None, volume_parts={}, container=replace(container(), rings=None))
    text = written(tmp_path, replace(count, distribution=None))
    assert "<model-viewer src" in text and "replay --direct" in text
    assert "Parts of V" not in text and not (tmp_path / "surface.ply").exists()


def test_a_large_scan_stays_below_4_mb(tmp_path):
    """A surface of half a million triangles, rough and in all colours, and a 2 megapixel view."""
    random, side = np.random.default_rng(0), 500
    rows, cols = np.mgrid[:side, :side]
    height = 0.05 + 0.01 * np.sin(cols / 5) * np.sin(rows / 5) + random.normal(0, 5e-4, rows.shape)
    index = np.arange(rows.size).reshape(rows.shape)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1],
                                      index[1:, 1:]))
    mesh = Mesh(np.stack([(cols / side - .5) * .36, (rows / side - .5) * .26, height], axis=-1)
                .reshape(-1, 3).astype(np.float32),
                np.concatenate([np.column_stack([a, b, d]), np.column_stack([a, d, c])])
                .astype(np.int32), random.integers(0, 255, (rows.size, 3)).astype(np.uint8))
    view = counted_bin().volume.key_view
    color = cv2.GaussianBlur(random.integers(0, 255, (1200, 1600, 3)).astype(np.uint8), (0, 0), 3)
    view = replace(view, color=cv2.normalize(color, None, 0, 255, cv2.NORM_MINMAX), depth=None,
                   labels=cv2.resize(view.labels, (1600, 1200), interpolation=cv2.INTER_NEAREST))
    assert 2e6 < len(written(tmp_path, counted_bin(mesh=mesh, key_view=view))) < 4e6


@pytest.mark.parametrize("changes", [
    {"mesh": Mesh(np.random.default_rng(0).random((500, 3)).astype(np.float32),
                  np.zeros((0, 3), np.int32)),
     "container": Container("hull", np.eye(4)), "top": None, "inner": None, "key_view": None},
    {"mesh": None, "container": Container("none", np.eye(4)), "top": None, "inner": None,
     "key_view": None, "volume_parts": {}},
    {"stack_volume": 0.0, "stack_volume_std": 0.0,
     "volume_parts": {"seen": 0.0, "filled": 0.0, "wall": 0.0}}],
    ids=["hull", "nothing", "empty"])
def test_what_is_not_known_is_left_out(tmp_path, changes):
    outline = Outline(written(tmp_path, counted_bin(reasons=[Reason.NO_DEPTH], **changes)))
    assert "⚠ Degraded" in " ".join(outline.words)
    assert bool(outline.all("model-viewer")) == (changes.get("mesh", 1) is not None)
    if changes.get("key_view", 1) is None:
        assert "Key view" not in " ".join(outline.words)


def test_a_region_is_named(tmp_path):
    assert "left" in " ".join(Outline(written(tmp_path, counted_bin(region="left"))).words)
