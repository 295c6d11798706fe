# SPDX-License-Identifier: Apache-2.0
"""Things beside each other on one plane, in closed form: which one is meant."""

import pytest
from kits.analytic import Scene

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.pipeline import StackCounter

INNER, FILL = (0.3, 0.2, 0.12), 0.07


def reconstruct(views, **settings):
    stack = StackCounter(ReconstructorConfig(**settings))
    for view in views:
        stack.add_view(view)
    return stack.volume()


def test_two_containers_are_refused_unless_one_is_in_the_region_of_interest():
    scene = Scene().bin(INNER, 0.005, 0.005, FILL).bin((0.2, 0.2, 0.1), 0.005, 0.005, 0.05, 0.4)
    views = scene.views(6, noise=0.001, radius=1.0, center=(0.2, 0, 0.05))
    with pytest.raises(ScanError, match=r"^2 containers; .*roi_center_m: \[-?0\.0.*"
                                        r"roi_center_m: \[(0.39|0.4)"):
        reconstruct(views)
    chosen = reconstruct(views, roi_center_m=(0.4, 0, 0.05), roi_size_m=(0.3, 0.3, 0.3))
    assert chosen.container.T_world_container[0, 3] == pytest.approx(0.4, abs=0.003)


@pytest.mark.parametrize("side, settings, crowded", [
    (0.12, {}, True), (0.05, {}, False),
    (0.12, {"roi_center_m": (0.0, 0.0, 0.05), "roi_size_m": (0.3, 0.3, 0.3)}, False)],
    ids=["as large", "small", "a region says which"])
def test_a_thing_beside_the_heap_is_said(side, settings, crowded):
    scene = Scene().sphere((0, 0, 0.0), 0.08).box(
        [0.25, 0, side / 3], [side, side, 2 * side / 3])
    volume = reconstruct(scene.views(4, noise=0.0005, radius=0.8, center=(0.1, 0, 0)), **settings)
    assert ("crowded" in volume.reasons) == crowded


@pytest.mark.parametrize("place, height, crowded", [
    ((0.33, 0), 0.12, True), ((0, 0.24), 0.12, True), ((0.33, 0), 0.06, False)])
def test_what_stands_close_beside_the_container_is_said(place, height, crowded):
    """As a bin heaped so high that it shows no opening, and not a lower board."""
    scene = Scene().bin(INNER, 0.005, 0.005, FILL).box(
        (*place, height / 2), (0.3, 0.2, height))
    volume = reconstruct(scene.views(6, noise=0.0005, radius=1.0, center=(0.15, 0, 0)))
    assert max(volume.container.inner_size_m) == pytest.approx(INNER[0], abs=0.003)
    assert ("crowded" in volume.reasons) == crowded
