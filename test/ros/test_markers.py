# SPDX-License-Identifier: Apache-2.0
"""What RViz and Foxglove show, against what was put in."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import Point32, Polygon
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from stack_counter_msgs.msg import PosedImage, StackCount, VisiblePart
from visualization_msgs.msg import Marker

from stack_counter import geometry
from stack_counter.ros.conversions import to_stack_volume
from stack_counter.ros.markers import (
    TextPlace,
    count_marker,
    count_text,
    scene_markers,
    surface_marker,
    surface_points,
    text_place,
    visible_marker,
)
from stack_counter.ros.standard_messages import to_header
from stack_counter.types import (
    Container,
    HeightMap,
    Intrinsics,
    Mesh,
    Reason,
    StackVolume,
    View,
    ViewTally,
)

HEADER = to_header(1_700_000_000_123_456_789, "cell")
CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
MESH = Mesh(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0.3]], np.float32),
            np.array([[2, 0, 1]], np.int32),
            np.array([[255, 128, 1], [0, 0, 0], [2, 3, 255]], np.uint8))
REGION = (np.array([-0.1, -0.1, 0.0]), np.array([0.1, 0.1, 0.2]))


def volume(container=Container("none", np.eye(4)), mesh=MESH, **fields):
    return StackVolume(5, 1e-3, 1e-5, container, (0, 0, 0), 1.0, fields.pop("top", None), None,
                       None, ViewTally(), mesh=mesh, **fields)


def box(height=0.12, at=(1.0, 2.0, 0.5)):
    square = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]]) * [0.15, 0.1]
    rings = np.stack([np.column_stack([square, np.full(4, z)]) for z in (0.0, 0.01, height)])
    return Container("box", geometry.pose(np.eye(3), np.array(at)), (0.3, 0.2, height - 0.01),
                     0.005, 0.01, rings)


def points(marker):
    return np.array([[p.x, p.y, p.z] for p in marker.points])


def test_a_scan_shows_all_in_the_frame_and_at_the_time_of_its_data():
    T = geometry.look_at(np.array([0.3, 0.4, 0.8]), np.zeros(3))
    views = [View(0, CAMERA, T), View(1, CAMERA, np.eye(4))]
    first, *markers = scene_markers([volume(box())], [REGION], views, HEADER).markers
    assert first.action == Marker.DELETEALL and first.ns == ""  # an empty one means all
    shown = {m.ns: m for m in markers}
    assert list(shown) == ["container", "region", "cameras", "surface"]
    assert all(m.header == HEADER and m.action == Marker.ADD and m.color.a == 1.0
               and m.scale.x > 0 and m.pose.orientation.w == 1.0 for m in markers)
    assert {m.ns: m.type for m in markers} == {
        "container": Marker.LINE_LIST, "region": Marker.LINE_LIST, "cameras": Marker.LINE_LIST,
        "surface": Marker.TRIANGLE_LIST}
    wall = points(shown["container"])
    np.testing.assert_allclose(wall.min(axis=0), [0.85, 1.9, 0.51])
    np.testing.assert_allclose(wall.max(axis=0), [1.15, 2.1, 0.62])
    np.testing.assert_allclose(points(shown["region"]).max(axis=0), REGION[1])
    cameras = points(shown["cameras"]).reshape(2, 16, 3)  # a pyramid has eight lines
    np.testing.assert_allclose(cameras[0, 0], [0.3, 0.4, 0.8])
    np.testing.assert_allclose(cameras[1].max(axis=0), [0.032, 0.024, 0.06])


@pytest.mark.parametrize("shown, expected", [
    (([volume()], [], []), ["surface"]),
    (([volume(mesh=None)], [REGION], []), ["region"]),
    (([volume(mesh=replace(MESH, triangles=MESH.triangles[:0]))], [], []), []),
    (([], [REGION], [View(0, CAMERA, np.eye(4))]), ["region", "cameras"])],
    ids=["heap", "no mesh", "points only", "no volume"])
def test_what_there_is_not_is_left_out_and_the_old_goes(shown, expected):
    markers = scene_markers(*shown, HEADER).markers
    assert [m.action for m in markers] == [Marker.DELETEALL] + [Marker.ADD] * len(expected)
    assert [m.ns for m in markers[1:]] == expected


def test_regions_have_markers_of_their_own_and_one_surface():
    other = Mesh(MESH.vertices + 1, MESH.triangles)  # by height: without colours
    _, *markers = scene_markers([volume(box()), volume(box(at=(0.0, 0.0, 0.0)), mesh=other)],
                                [REGION, REGION], [], HEADER).markers
    assert [(m.ns, m.id) for m in markers] == [
        ("container", 0), ("container", 1), ("region", 0), ("region", 1), ("surface", 0)]
    corners = MESH.vertices[MESH.triangles[0]]
    np.testing.assert_allclose(points(markers[-1]), np.concatenate([corners, corners + 1]),
                               atol=1e-6)
    assert markers[-1].colors[0].r == pytest.approx(MESH.colors[MESH.triangles[0, 0], 0] / 255)


def test_triangles_have_the_corners_and_colours_of_the_mesh():
    marker = surface_marker(MESH, HEADER)
    np.testing.assert_allclose(points(marker), MESH.vertices[[2, 0, 1]], atol=1e-7)
    colors = np.array([[c.r, c.g, c.b, c.a] for c in marker.colors])
    np.testing.assert_allclose(colors, np.column_stack([MESH.colors[[2, 0, 1]] / 255, np.ones(3)]),
                               atol=1e-6)
    assert (marker.scale.x, marker.scale.y, marker.scale.z) == (1, 1, 1)


def test_a_large_mesh_is_a_message_of_few_megabytes():
    n = 300
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    mesh = Mesh(np.stack([u, v, 0.1 * u * v], -1).reshape(-1, 3).astype(np.float32),
                np.concatenate([np.stack([i, i + 1, i + n], 1),
                                np.stack([i + 1, i + n + 1, i + n], 1)]).astype(np.int32))
    marker = surface_marker(mesh, HEADER)
    assert 5000 * 3 < len(marker.points) == len(marker.colors) <= 20_000 * 3
    assert len(serialize_message(marker)) < 2_500_000


def test_a_cloud_packs_each_colour_as_point_clouds_do():
    cloud = surface_points(MESH, HEADER)
    assert cloud.header == HEADER and (cloud.height, cloud.width) == (1, 3)
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        ("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 12, 7, 1)]
    assert (cloud.point_step, cloud.row_step, cloud.is_bigendian) == (16, 48, False)
    values = np.frombuffer(bytes(cloud.data), np.uint32).reshape(3, 4)
    np.testing.assert_array_equal(values[:, :3].copy().view(np.float32), MESH.vertices)
    assert values[:, 3].tolist() == [0xff8001, 0x000000, 0x0203ff]


def test_a_cloud_without_colours_is_coloured_by_height_and_one_of_nothing_is_empty():
    plain = np.frombuffer(bytes(surface_points(replace(MESH, colors=None), HEADER).data),
                          np.uint32).reshape(3, 4)
    assert plain[0, 3] == plain[1, 3] == 0x440154 and plain[2, 3] == 0xfde725  # of viridis
    for nothing in (None, Mesh(MESH.vertices[:0], MESH.triangles[:0])):
        empty = surface_points(nothing, HEADER)
        assert (empty.width, len(empty.data), len(empty.fields)) == (0, 0, 4)


def test_text_of_a_region_begins_with_its_name():
    assert count_text(StackCount(region="left", count=4, count_low=3, count_high=5,
                                 confidence=0.9)) == "left: 4 parts (3 to 5, 90%)"
    assert count_text(StackCount(region="left", error="2 views used")) == "left: 2 views used"


def test_text_says_count_interval_and_confidence():
    count = StackCount(count=412, count_low=391, count_high=430, confidence=0.9)
    assert count_text(count) == "412 parts (391 to 430, 90%)"
    one = StackCount(count=1, count_low=0, count_high=2, confidence=0.95,
                     status=StackCount.STATUS_DEGRADED, reasons=["no_depth", "single_view"])
    first, *sentence = count_text(one).splitlines()
    assert first == "1 part (0 to 2, 95%)"
    assert " ".join(sentence) == Reason.NO_DEPTH.sentence  # a single view does not degrade a count
    assert max(map(len, sentence)) <= 40
    long = StackCount(status=StackCount.STATUS_ERROR, error="2 views used of 7 (skipped: "
                      "{'no_tf': 5}); expected at least 3")
    assert count_text(long) == ("2 views used of 7 (skipped: {'no_tf':\n"
                                "5}); expected at least 3")


@pytest.mark.parametrize("status, color", [(StackCount.STATUS_OK, (0.3, 0.9, 0.3)),
                                           (StackCount.STATUS_DEGRADED, (1.0, 0.6, 0.1)),
                                           (StackCount.STATUS_ERROR, (1.0, 0.25, 0.2))])
def test_text_stands_above_its_place_and_has_the_colour_of_its_status(status, color):
    count = StackCount(header=HEADER, status=status, confidence=0.9)
    place = TextPlace(np.array([1.0, 2.0, 0.62]), 0.03)
    marker = count_marker(count, place)
    assert (marker.type, marker.header, marker.ns) == (Marker.TEXT_VIEW_FACING, HEADER, "count")
    at = marker.pose.position
    assert (at.x, at.y) == (1.0, 2.0) and at.z - 0.03 / 2 > 0.62
    assert marker.scale.z == 0.03
    assert (marker.color.r, marker.color.g, marker.color.b) == pytest.approx(color)


def place_of(core):
    place = text_place(to_stack_volume(core, "cell", PosedImage(), final=True))
    return place.point, place.letter_m


def test_text_is_placed_above_rim_stack_or_hull():
    at, letter = place_of(volume(box()))
    np.testing.assert_allclose(at, [1.0, 2.0, 0.5 + 0.12])
    assert letter == pytest.approx(0.031)  # the wall belongs to the width
    heights = np.full((5, 8), 0.02, np.float32)
    heights[2, 2], heights[0, 0] = 0.15, np.nan
    over = HeightMap(np.eye(4), 0.04, heights)
    np.testing.assert_allclose(place_of(volume(box(), top=over))[0], [1.0, 2.0, 0.5 + 0.15])
    T = geometry.pose(Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix(), np.array([1.0, 2, 3]))
    at, letter = place_of(volume(Container("none", T), top=over))
    np.testing.assert_allclose(at, [1.15, 2.0, 3.0])  # up is the container's z
    assert letter == pytest.approx(0.032)
    at, letter = place_of(volume(Container("hull", np.eye(4))))  # a litre
    np.testing.assert_allclose(at, [0, 0, 0.05])
    assert letter == pytest.approx(0.01)
    failed = to_stack_volume(volume(), "cell", PosedImage(), final=True)
    failed.error = "2 views used"
    assert text_place(failed) is None


def test_parts_that_show_are_outlined_and_go_when_none_do():
    triangle = Polygon(points=[Point32(x=x, y=y, z=0.5) for x, y in ((0.0, 0), (1, 0), (0, 1))])
    count = StackCount(header=HEADER, visible_parts=[VisiblePart(outline=triangle)] * 2)
    marker = visible_marker(count, 3)
    assert (marker.ns, marker.id, marker.action) == ("visible_parts", 3, Marker.ADD)
    assert marker.header == HEADER and len(marker.points) == 2 * 3 * 2
    assert points(marker)[:6].tolist() == [[0, 0, .5], [1, 0, .5], [1, 0, .5], [0, 1, .5],
                                           [0, 1, .5], [0, 0, .5]]
    gone = visible_marker(StackCount(header=HEADER), 3)
    assert (gone.ns, gone.id, gone.action) == ("visible_parts", 3, Marker.DELETE)
