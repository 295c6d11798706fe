# SPDX-License-Identifier: Apache-2.0
"""Containers of every kind against the simulator's, filled flat: a closed form for V."""

from pathlib import Path

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.pipeline import StackCounter
from stack_counter.sim import record
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.shards import find_scene

DRAFT = np.deg2rad(8)
SHAPES = {
    "tote": ("box", ContainerShape("bin", geometry.pose(np.eye(3), np.array([0.03, -0.02, 0])),
                                   (0.3, 0.2, 0.12), 0.004, 0.004, DRAFT)),
    "can": ("round", ContainerShape("cylinder", np.eye(4), (0.2, 0.2, 0.15), 0.003, 0.003)),
    "cup": ("round", ContainerShape("cup", np.eye(4), (0.15, 0.15, 0.15), 0.005, 0.005, DRAFT)),
    "bowl": ("round", ContainerShape("bowl", np.eye(4), (0.3, 0.3, 0.11), 0.006, 0.006)),
    "bag": ("free", ContainerShape("bag", np.eye(4), (0.2, 0.16, 0.12), 0.004, 0.004, seed=3)),
}


def reconstruct(scene, noise=0.001, views=12, **settings):
    stack = StackCounter(ReconstructorConfig(**settings))
    for view in scene.views(views, noise=noise, tilts=(12, 28, 42)):
        stack.add_view(view)
    return stack.volume()


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("share", [0.35, 0.7])
def test_every_kind_is_found_and_measured(name, share):
    kind, shape = SHAPES[name]
    scene = Scene()
    truth = scene.filled(shape, share * shape.inner_size_m[2])
    result = reconstruct(scene)
    found = result.container
    assert found.kind == kind
    assert sorted(found.inner_size_m[:2]) == pytest.approx(sorted(shape.inner_size_m[:2]),
                                                           rel=0.01)
    assert found.wall_thickness_m == pytest.approx(shape.wall_thickness_m, abs=0.0015)
    assert result.stack_volume == pytest.approx(truth, rel=0.05)


@pytest.mark.parametrize("name", SHAPES)
def test_an_empty_one_holds_nothing(name):
    kind, shape = SHAPES[name]
    scene = Scene()
    scene.filled(shape, 0.0)
    result = reconstruct(scene)
    assert result.container.kind == kind
    assert result.stack_volume < 0.01 * 0.5 * np.prod(shape.inner_size_m)


def test_a_round_one_is_used_as_configured():
    _, shape = SHAPES["can"]
    scene = Scene()
    truth = scene.filled(shape, 0.08)
    result = reconstruct(scene, container_kind="round", container_pose="given",
                         container_inner_size_m=(0.2, 0.2, 0.15), container_wall_m=0.003,
                         container_floor_m=0.003)
    assert result.container.inner_size_m == pytest.approx((0.2, 0.2, 0.15), rel=1e-3)
    assert result.stack_volume == pytest.approx(truth, rel=0.03)


def test_a_kind_that_is_not_there_is_named():
    with pytest.raises(ScanError, match="no round container found: a level rim on"):
        reconstruct(Scene().box([0.02, 0.01, 0.03], [0.2, 0.15, 0.06], 0.3),
                    container_kind="round")


def test_a_ball_is_no_container():
    """Over its top a camera sees its far side, as it sees a wall's inner face."""
    result = reconstruct(Scene().sphere((0, 0, 0.1), 0.1), views=6)
    assert result.container.kind == "none" and "container_unsure" in result.reasons


@pytest.mark.parametrize("name, found, reasons", [
    ("train-shallow:297", "round", ()), ("train-deep:1014", "none", ("container_unsure",))])
def test_what_is_nearly_a_container_is_one_or_is_said(name, found, reasons):
    """A bowl whose outside no view sees; a low bin that heaped plates hide all around."""
    scene = find_scene(f"{Path(__file__).parents[2] / 'data' / name}")
    stack = StackCounter(ReconstructorConfig(), scene.truth.unit_volume)
    for view in record(scene, 12, color=False):
        stack.add_view(view)
    volume = stack.volume()
    assert volume.container.kind == found and volume.reasons == reasons
