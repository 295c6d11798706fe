# SPDX-License-Identifier: Apache-2.0
"""Open3D loads without its plots in a browser, which stay as they are for who calls them."""

import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def printed():
    """What a fresh interpreter prints that loads Open3D, then asks for a plot."""
    code = ("import sys\nfrom stack_counter.lean_open3d import o3c, o3d\n"
            "print('dash' in sys.modules, o3c is o3d.core)\n"
            "for function in (o3d.visualization.get_plotly_fig, o3d.visualization.draw_plotly):\n"
            "    try: function(0)\n"
            "    except Exception as error: print(type(error).__name__)\n"
            "print('dash' in sys.modules, o3d.visualization.draw_plotly.__code__.co_filename)\n")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\n")


def test_open3d_loads_nothing_for_plots(printed):
    assert printed[0] == "False True"


def test_a_plot_is_open3ds_own(printed):
    assert printed[1] == printed[2] == "TypeError"  # of 0, which is no list of shapes
    assert printed[3].startswith("True ") and printed[3].endswith("draw_plotly.py")
