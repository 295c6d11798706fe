# SPDX-License-Identifier: Apache-2.0
"""The page of a report in headless Chromium: it loads its model, and asks for nothing."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from kits.browser import CHROMIUM, browser_page
from kits.counted_bin import counted_bin, plausible_parts

from stack_counter.config import Config
from stack_counter.display.page.subject import ReportSubject
from stack_counter.display.report import write_report
from stack_counter.types import Reason

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium, chromium-browser or "
                                                         "google-chrome on the path")
MODEL_IS_THERE = """new Promise((done, fail) => {
  const viewer = document.querySelector('model-viewer');
  viewer.addEventListener('error', event => fail(event.detail));
  viewer.loaded ? done('load') : viewer.addEventListener('load', event => done(event.type)); })"""
# `loaded` is true before the event, on which the page takes the picture away.
MODEL_IS_SHOWN = """new Promise(done => {
  const look = () => document.querySelector('#model').classList.contains('ready')
    ? done(true) : requestAnimationFrame(look);
  look(); })"""
REASONS = (Reason.ONE_SIDE, Reason.LOW_COVERAGE, Reason.NOISY_DEPTH, Reason.CROWDED)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    write_report(folder, counted_bin(REASONS), [], ReportSubject(
        "bin 7", "nut", "unsure", "expected 100 ± 2", settings=vars(Config()),
        arrangement=plausible_parts()))
    return folder / "report.html"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with browser_page(tmp_path_factory.mktemp("profile")) as page:
        yield page


def test_the_model_loads_and_nothing_is_requested(browser, path):
    browser.look(1000, 700)
    browser.open(path)
    assert browser.value(MODEL_IS_THERE) == "load"
    assert browser.value(MODEL_IS_SHOWN)
    assert browser.requests == [path.as_uri()]
    assert browser.errors == []
    # A button looks at it from above.
    browser.value("document.querySelector('button:nth-child(2)').click()")
    assert browser.value("""(async viewer => {
        viewer.jumpCameraToGoal();
        await viewer.updateComplete;
        return viewer.getCameraOrbit().phi; })(document.querySelector('model-viewer'))""") < 0.01
    # The model is drawn: its red and its blue half, and the ground of the page beside them.
    picture = browser.screenshot("model-viewer").astype(int)
    blue, _, red = np.moveaxis(picture, -1, 0)
    assert (red > blue + 40).mean() > 0.02 and (blue > red + 40).mean() > 0.02
    assert (picture.min(axis=-1) > 250).mean() > 0.2


def test_what_may_lie_below_shows_through_the_surface(browser, path):
    browser.look(1000, 900)
    browser.open(path)
    assert browser.value(MODEL_IS_SHOWN)
    materials = """JSON.stringify(document.querySelector('model-viewer').model.materials.map(
        m => [m.name, m.getAlphaMode(), m.pbrMetallicRoughness.baseColorFactor[3]]))"""
    opaque = [["surface", "OPAQUE", 1], ["container", "OPAQUE", 1],
              ["plausible parts", "MASK", 0]]
    assert json.loads(browser.value(materials)) == opaque
    box = "document.querySelector('.inside input').click()"
    browser.value(box)
    surface, container, parts = json.loads(browser.value(materials))
    assert surface[1] == "BLEND" and surface[2] < 0.5
    assert container == opaque[1] and parts[1:] == ["OPAQUE", 1]
    browser.value(box)
    assert json.loads(browser.value(materials)) == opaque and browser.errors == []


def test_a_fetch_is_refused_by_the_policy(browser, path):
    browser.look(1000, 700, script=True)
    browser.open(path)
    assert browser.value("fetch('http://127.0.0.1:9/').then(() => 'fetched', () => 'refused')") \
        == "refused"
    assert any("Content Security Policy" in error for error in browser.errors)


@pytest.mark.parametrize("width", [360, 768, 1280])
def test_nothing_sticks_out_at_the_side(browser, path, width):
    browser.look(width, 800, script=False)
    browser.open(path)
    assert browser.value("document.documentElement.scrollWidth") <= width


def test_without_script_the_picture_stands_for_the_model(browser, path):
    browser.look(700, 900, script=False)
    browser.open(path)
    picture = browser.screenshot(".poster").astype(int)
    assert (picture.max(axis=-1) - picture.min(axis=-1) > 60).mean() > 0.05
    assert browser.value("getComputedStyle(document.querySelector('.buttons')).visibility") \
        == "hidden"


def test_labels_go_and_come_without_script(browser, path):
    browser.look(700, 900, script=False)
    browser.open(path)
    tinted = browser.screenshot(".layers").astype(int)
    browser.value("document.querySelector('#labels').checked = false")
    plain = browser.screenshot(".layers").astype(int)
    assert np.abs(tinted - plain).mean() > 5


def test_it_prints_on_one_page(browser, path):
    browser.look(1000, 700, script=False, media="")
    browser.open(path)
    assert len(re.findall(rb"/Type\s*/Page\b", browser.pdf())) == 1


def axe_script():
    """The rules of axe-core where npm has it (npm install -g axe-core); else None."""
    if shutil.which("npm") is None:
        return None
    root = subprocess.run(["npm", "root", "-g"], capture_output=True, text=True).stdout.strip()
    script = Path(root) / "axe-core" / "axe.min.js"
    return script.read_text() if script.is_file() else None


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_axe_finds_no_barrier(browser, path, dark):
    script = axe_script()
    if script is None:
        pytest.skip("no axe-core; npm install -g axe-core brings it")
    browser.look(1280, 900, dark=dark)
    browser.open(path)
    browser.value(f"{script}; 1")
    found = browser.value("axe.run().then(r => r.violations.map(v => [v.id, "
                          "v.nodes.map(n => n.html.slice(0, 200))]))")
    assert found == []
