# SPDX-License-Identifier: Apache-2.0
"""Simulated experiments: the table of measurements, a pile with known answer, rows and page."""

from dataclasses import replace

import numpy as np
import pytest

from stack_counter.sim import Scene
from stack_counter.sim.reality import piles
from stack_counter.sim.reality.__main__ import main
from stack_counter.sim.reality.experiments import (
    DENSE,
    EXPERIMENTS,
    LOOSE,
    POURED,
    Experiment,
    Tub,
)
from stack_counter.sim.reality.parts import die, ellipsoid, ring
from stack_counter.sim.reality.piles import Pile
from stack_counter.sim.reality.plot import draw_plot
from stack_counter.sim.reality.table import (
    BEGIN,
    END,
    PageError,
    Row,
    check_page,
    markdown_table,
    summarize,
    write_into_page,
)
from stack_counter.sim.scenes.containers import ContainerShape

CUBES = Experiment("cubes", lambda: die("cube"), POURED, "nobody", 0.5, spread=0.02)
SHARES = (0.52, 0.56)
ROW = Row(CUBES, 0.5, 0.2, [Pile(share, 1, 2.0) for share in SHARES])


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda e: f"{e.name}, {e.pour}")
def test_measured_values_are_well_formed(experiment):
    assert (experiment.gamma is None) != (experiment.per_m3 is None)
    assert experiment.source and experiment.pour in (LOOSE, POURED, DENSE)
    measured = experiment.measured_share(experiment.part())
    assert 0.1 < measured < 0.78 and 0 < experiment.spread < measured / 4


def test_only_balls_and_dice_are_fitted_and_no_row_is_there_twice():
    assert all(e.fitted == (e.name.partition(":")[0] in ("dice", "balls", "glass balls, 13 and "
                                                         "25 mm")) for e in EXPERIMENTS)
    assert len({(e.name, e.pour) for e in EXPERIMENTS}) == len(EXPERIMENTS)


def test_the_pours_span_the_friction_of_the_sets():
    assert piles.friction_of(DENSE) < piles.friction_of(POURED) < piles.friction_of(LOOSE)


def test_cubes_on_a_lattice_have_the_lattices_gamma():
    """A cube in each cell of 1.1 sizes fills 1 / 1.1 ** 3, in the bulk and in a tub."""
    cube, n = die("cube"), 10
    pitch = 1.1 * cube.part_size
    cell = (np.mgrid[:n, :n, :n].reshape(3, -1).T + 0.5) * pitch
    side, wall = n * pitch, 0.2 * cube.part_size
    poses = np.column_stack([cell - [side / 2, side / 2, -wall], np.zeros((n**3, 3)),
                             np.ones(n**3)])
    for kind, measure in (("bin", piles.measure_bulk),
                          ("cylinder", lambda scene: piles.measure_tub(
                              scene, Tub(side, 0.6 * side)))):
        box = ContainerShape(kind, np.eye(4), (side, side, side), wall, wall)
        inside = box.is_over_opening(poses[:, :3])
        assert measure(Scene(0, 0, cube, box, poses[inside])) == pytest.approx(1.1**-3, rel=0.08)


def test_a_tub_that_is_not_full_is_no_measurement():
    cube = die("cube")
    tub = ContainerShape("cylinder", np.eye(4), (0.06, 0.06, 0.08), 0.002, 0.002)
    scene = Scene(0, 0, cube, tub, np.array([[0, 0, 0.01, 0, 0, 0, 1.0]]))
    with pytest.raises(piles.SceneError, match="tub not full"):
        piles.measure_tub(scene, Tub(0.06, 0.06))


def test_a_tiny_pile_is_the_same_again_and_no_denser_than_crystals():
    pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")
    balls = Experiment("balls", lambda: ellipsoid("ball", 20, 20, 20), POURED, "nobody", 0.585,
                       bodies=60)
    first, again = (piles.simulate_experiment(balls, 0, 0.2) for _ in range(2))
    assert first.share == again.share
    assert 0.4 < first.share < 0.741


def test_rows_say_what_is_off():
    assert ROW.predicted == pytest.approx(0.54) and ROW.difference == pytest.approx(0.04)
    assert ROW.scatter == pytest.approx(0.04 / 2**0.5)
    assert "error 0.040 (in gamma, hollow parts too, 0.040), bias +0.040, worst cubes" \
        in summarize([ROW])[0]
    hulls = replace(ROW, experiment=replace(CUBES, part=lambda: ring("ring", 25, 25, 1),
                                            of_hull=True))
    assert hulls.gamma_difference < 0.2 * hulls.difference
    assert "| +0.040 (+8%) | predicted | nobody |" in markdown_table([ROW])


def test_the_page_gets_the_table_and_keeps_the_rest(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_into_page(page, "new")
    assert page.read_text() == f"before\n{BEGIN}\nnew\n{END}\nafter\n"
    draw_plot([ROW], tmp_path / "page.png")
    assert (tmp_path / "page.png").stat().st_size > 1000


def test_an_unknown_item_is_refused_with_the_known_ones(capsys):
    assert main(["--items", "banana"]) == 2
    assert "soybean" in capsys.readouterr().err


def test_a_page_without_a_place_is_refused_before_anything_is_simulated(tmp_path, capsys):
    page = tmp_path / "page.md"
    for text, what in ((None, "cannot be read"), ("nothing", "0 places"),
                       (2 * f"{BEGIN}\n{END}\n", "2 places")):
        if text is not None:
            page.write_text(text)
        with pytest.raises(PageError, match=what):
            check_page(page)
        assert main(["--page", str(page)]) == 2
        assert what in capsys.readouterr().err
