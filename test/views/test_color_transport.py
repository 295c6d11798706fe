# SPDX-License-Identifier: Apache-2.0
"""Raw or compressed: what is published decides, and what the settings miss is named."""

import pytest

from stack_counter.views.color_transport import published_transports, wrong_transport_line


@pytest.mark.parametrize("publishers, found", [
    ({}, []), ({"/c": 1}, ["raw"]), ({"/c/compressed": 2}, ["compressed"]),
    ({"/c": 1, "/c/compressed": 1}, ["raw", "compressed"]), ({"/c": 0, "/d": 1}, [])])
def test_raw_comes_first(publishers, found):
    assert published_transports("/c", lambda topic: publishers.get(topic, 0)) == found


@pytest.mark.parametrize("setting, publishers, line", [
    ("raw", {"/c/compressed": 1},
     "/c/compressed has 1 publisher: set color_transport: compressed (or auto)"),
    ("compressed", {"/c": 2}, "/c has 2 publishers: set color_transport: raw (or auto)"),
    ("auto", {"/c/compressed": 1}, ""), ("raw", {}, ""), ("raw", {"/c": 1}, ""),
    ("compressed", {"/c": 1, "/c/compressed": 1}, "")])
def test_images_by_the_other_transport_are_named(setting, publishers, line):
    assert wrong_transport_line("/c", setting, lambda topic: publishers.get(topic, 0)) == line
