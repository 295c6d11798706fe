# SPDX-License-Identifier: Apache-2.0
"""How finely a surface is resolved, in part lengths."""

from dataclasses import replace

import numpy as np
import pytest
from kits.surfaces import sine_hills, stack_volume_of_heights

from stack_counter.fusion.pixel_spacing import pixel_spacing
from stack_counter.geometry import look_at
from stack_counter.occupancy.resolution import measured_resolution, resolution_values
from stack_counter.types import Intrinsics, Reason, View

V = 8e-6  # m3; a part length is 20 mm


def test_it_is_in_part_lengths_and_says_where_the_surface_comes_from():
    volume = replace(stack_volume_of_heights(sine_hills(1.0)), resolution_m=0.004)
    pictures = replace(volume, reasons=(Reason.DEPTH_FROM_PICTURES,))
    np.testing.assert_array_equal(measured_resolution(volume, V), resolution_values(0.2, False))
    np.testing.assert_array_equal(measured_resolution(pictures, V), resolution_values(0.2, True))
    assert measured_resolution(volume, V / 8)[0] > measured_resolution(volume, V)[0]


def test_where_none_is_measured_it_is_the_maps_cell_or_the_usual_one():
    volume = stack_volume_of_heights(sine_hills(1.0), pitch=0.002)
    np.testing.assert_array_equal(measured_resolution(volume, V), resolution_values(0.1, False))
    assert not measured_resolution(stack_volume_of_heights(None), V).any()


def test_a_pixel_spans_distance_over_focal_length():
    views = [View(0, Intrinsics(64, 48, f, f, 31.5, 23.5),
                  look_at(np.array([d, 0, 0.3]), np.zeros(3)))
             for d, f in ((0.4, 500), (0.4, 500), (4.0, 100))]
    assert pixel_spacing(views, np.zeros(3)) == pytest.approx(0.5 / 500)
