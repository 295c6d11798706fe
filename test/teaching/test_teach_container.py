# SPDX-License-Identifier: Apache-2.0
"""A container taught by an empty-bin scan, stored, and counted with elsewhere."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import save_container
from stack_counter.errors import ScanError
from stack_counter.pipeline import StackCounter
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.teaching.teach_container import taught_from

TOTE = ContainerShape("bin", np.eye(4), (0.3, 0.2, 0.12), 0.004, 0.006, np.deg2rad(8))
BAG = ContainerShape("bag", np.eye(4), (0.2, 0.16, 0.12), 0.004, 0.004, seed=3)


def at(shape, x, y, yaw):
    """The shape elsewhere on the support plane."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return replace(shape, T_world_container=geometry.pose(turn, np.array([x, y, 0])))


def reconstruct(scene, **settings):
    stack = StackCounter(ReconstructorConfig(**settings))
    for view in scene.views(12, noise=0.001, tilts=(12, 28, 42)):
        stack.add_view(view)
    return stack.volume()


def filled(shape, share):
    """Scene and true V of a shape filled flat to a share of its depth."""
    scene = Scene()
    return scene, scene.filled(shape, share * shape.inner_size_m[2])


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    path = tmp_path_factory.mktemp("catalogue") / "containers.yaml"
    for name, shape in (("tote", at(TOTE, 0.03, -0.02, 0.5)), ("bag", BAG)):
        save_container(name, taught_from(reconstruct(filled(shape, 0.0)[0]), "today"), path)
    return str(path)


@pytest.mark.parametrize("name, shape, x, y, yaw", [("tote", TOTE, -0.04, 0.03, -0.9),
                                                    ("bag", BAG, 0.03, -0.02, 2.2)])
@pytest.mark.parametrize("share", [0.3, 0.8])
def test_a_taught_container_gives_v_elsewhere(catalogue, name, shape, x, y, yaw, share):
    scene, truth = filled(at(shape, x, y, yaw), share)
    result = reconstruct(scene, container=name, container_catalogue=catalogue)
    T = result.container.T_world_container
    turned = np.arctan2(T[1, 0], T[0, 0]) - yaw
    if name == "tote":  # half a turn makes no difference
        turned *= 2
    assert T[:2, 3] == pytest.approx([x, y], abs=0.002)
    assert np.abs(np.angle(np.exp(1j * turned))) < np.deg2rad(1)
    assert result.stack_volume == pytest.approx(truth, rel=0.03)


def test_a_given_pose_is_used_as_given(catalogue):
    scene, truth = filled(at(TOTE, 0.05, 0.02, 0.4), 0.5)
    result = reconstruct(scene, container="tote", container_catalogue=catalogue,
                         container_pose="given", container_xyyaw=(0.05, 0.02, 0.4))
    T = result.container.T_world_container
    assert (T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])) == pytest.approx((0.05, 0.02, 0.4))
    assert result.stack_volume == pytest.approx(truth, rel=0.03)


def test_another_container_is_not_taken_for_it(catalogue):
    with pytest.raises(ScanError, match="container 'bag' not found: a rim 0.12. m high on .*75%"):
        reconstruct(filled(TOTE, 0.5)[0], container="bag", container_catalogue=catalogue)


def test_only_an_empty_container_teaches():
    with pytest.raises(ScanError, match="cm3, .*% of its capacity; expected an empty one"):
        taught_from(reconstruct(filled(TOTE, 0.3)[0]), "today")
    with pytest.raises(ScanError, match="container is 'none'; expected a box, round or free one"):
        taught_from(reconstruct(Scene().box([0, 0, 0.03], [0.2, 0.15, 0.06])), "today")


def test_teaching_a_container_needs_no_simulator():
    code = ("import sys, stack_counter.teaching.teach_container\n"
            "assert not {'manifold3d', 'coacd', 'sapien'} & set(sys.modules)")
    subprocess.run([sys.executable, "-c", code], check=True)
