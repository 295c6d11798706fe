# SPDX-License-Identifier: Apache-2.0
"""What RViz and Foxglove show: container, region, cameras, surface and count, as messages."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Point, Pose, Vector3
from sensor_msgs.msg import PointCloud2, PointField
from stack_counter_msgs.msg import StackCount
from stack_counter_msgs.msg import StackVolume as StackVolumeMsg
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from stack_counter.display.mesh_colors import display_colors
from stack_counter.display.mesh_decimation import decimate
from stack_counter.display.wireframes import box_lines, container_lines, frustum_lines
from stack_counter.ros.conversions import from_container, from_height_map
from stack_counter.ros.count_fields import from_reasons
from stack_counter.ros.standard_messages import to_bytes
from stack_counter.types import Mesh, StackVolume, View

_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])

ORANGE, WHITE, BLUE = (1.0, 0.6, 0.1), (0.8, 0.8, 0.8), (0.2, 0.6, 1.0)
GREEN, RED, YELLOW = (0.3, 0.9, 0.3), (1.0, 0.25, 0.2), (0.95, 0.9, 0.25)
_STATUS_COLORS = {StackCount.STATUS_OK: GREEN, StackCount.STATUS_DEGRADED: ORANGE,
                  StackCount.STATUS_ERROR: RED}


@dataclass(frozen=True)
class MarkerSettings:
    """Sizes of what is drawn; all are chosen.

    Attributes:
        max_triangles: most triangles of the surface marker. A triangle takes 120 bytes (three
            points of 24, three colours of 16), so the message has at most 2.4 MB; the point
            cloud has all vertices.
        frustum_m: depth of a camera's pyramid, m: small beside a bin, and still visible.
        line_m: width of lines, m.
        line_length: letters after which a line of text is broken.
        letter_share: height of a letter by the width of container or stack.
        letter_limits_m: smallest and largest height of a letter, m.
    """

    max_triangles: int = 20_000
    frustum_m: float = 0.06
    line_m: float = 0.002
    line_length: int = 40
    letter_share: float = 0.1
    letter_limits_m: tuple[float, float] = (0.01, 0.1)


SETTINGS = MarkerSettings()


def scene_markers(volumes: list[StackVolume], regions: list[tuple[np.ndarray, np.ndarray]],
                  views: list[View], header: Header) -> MarkerArray:
    """Returns the markers of a scan: namespaces `container`, `region`, `cameras` and `surface`.

    Args:
        volumes: of the regions that gave one.
        regions: low and high corner (3,) of each region of interest, world, metres.
        views: whose cameras are drawn.
        header: world frame, stamp of the data.
    """
    # Delete the markers of the last scan: this one may have less to show.
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    markers += [_line_marker("container", container_lines(volume.container), ORANGE, header, i)
                for i, volume in enumerate(volumes)]
    markers += [_line_marker("region", box_lines(*region), WHITE, header, i)
                for i, region in enumerate(regions)]
    frusta = [frustum_lines(v.intrinsics, v.T_world_camera, SETTINGS.frustum_m) for v in views]
    markers.append(_line_marker("cameras", np.array(frusta), BLUE, header))
    mesh = joined_mesh(volumes)
    if mesh is not None and len(mesh.triangles):
        markers.append(surface_marker(mesh, header))
    # A marker without points is an error in both viewers.
    return MarkerArray(markers=[m for m in markers if m.action != Marker.ADD or m.points])


def joined_mesh(volumes: list[StackVolume]) -> Mesh | None:
    """Returns the surfaces of all regions as one mesh; None where no region has one."""
    meshes = [volume.mesh for volume in volumes if volume.mesh is not None]
    if len(meshes) < 2:
        return meshes[0] if meshes else None
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]),
                np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts)]),
                np.concatenate([display_colors(mesh) for mesh in meshes]))


def _line_marker(ns: str, ends: np.ndarray, rgb: tuple[float, float, float], header: Header,
                 number: int = 0) -> Marker:
    """Returns the marker of lines with (..., 2, 3) float64 ends, world, metres."""
    return Marker(header=header, ns=ns, id=number, type=Marker.LINE_LIST,
                  scale=Vector3(x=SETTINGS.line_m), color=_to_color(rgb),
                  points=_to_points(ends.reshape(-1, 3)))


def surface_marker(mesh: Mesh, header: Header) -> Marker:
    """Returns the surface as triangles, decimated, with a colour for each corner.

    Foxglove ignores colours of faces.
    """
    mesh = decimate(mesh, SETTINGS.max_triangles)
    corners = mesh.triangles.ravel().tolist()
    points = _to_points(mesh.vertices)  # one message a vertex, which its triangles share
    colors = [_to_color(rgb) for rgb in (display_colors(mesh) / 255).tolist()]
    return Marker(header=header, ns="surface", type=Marker.TRIANGLE_LIST,
                  scale=Vector3(x=1.0, y=1.0, z=1.0), color=_to_color(WHITE),
                  points=[points[i] for i in corners], colors=[colors[i] for i in corners])


def surface_points(mesh: Mesh | None, header: Header) -> PointCloud2:
    """Returns the surface's vertices as a point cloud; one without points for None.

    Fields are x, y, z (float32, metres, world) and rgb: 0x00rrggbb in the bytes of a float, as
    point clouds have it.
    """
    points = np.zeros(0 if mesh is None else len(mesh.vertices), _POINT)
    if mesh is not None and len(points):
        points["x"], points["y"], points["z"] = mesh.vertices.T
        points["rgb"] = display_colors(mesh).astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1],
                                                                          np.uint32)
    fields = [PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
              for i, name in enumerate(("x", "y", "z", "rgb"))]
    return PointCloud2(header=header, height=1, width=len(points), fields=fields,
                       point_step=_POINT.itemsize, row_step=points.nbytes, is_dense=True,
                       data=to_bytes(points.view(np.uint8)))


@dataclass(frozen=True, eq=False)
class TextPlace:
    """Where the count is written.

    Attributes:
        point: (3,) float64 what the text stands above, world, metres.
        letter_m: height of a letter, m.
    """

    point: np.ndarray
    letter_m: float


ORIGIN_PLACE = TextPlace(point=np.zeros(3), letter_m=0.03)  # as long as there was no stack


def text_place(volume: StackVolumeMsg) -> TextPlace | None:
    """Returns the highest point of container and stack above their middle; None of no volume."""
    if volume.error:
        return None
    container, top = from_container(volume.container), from_height_map(volume.top)
    # Height and width of the container, of the stack's surface, or of a cube of its volume.
    cube_m = max(volume.stack_volume, 0.0) ** (1 / 3)
    height, width = container.outer_size_m[2], max(container.outer_size_m[:2])
    if top is not None and np.isfinite(top.heights).any():
        height = max(height, float(np.nanmax(top.heights)))
        width = width or max(top.heights.shape) * top.pitch
    height, width = height or cube_m / 2, width or cube_m
    T = container.T_world_container
    return TextPlace(T[:3, 3] + T[:3, 2] * height, float(np.clip(
        width * SETTINGS.letter_share, *SETTINGS.letter_limits_m)))


def count_marker(count: StackCount, place: TextPlace, number: int = 0) -> Marker:
    """Returns the count, or its error, as text above a place, coloured by its status.

    Args:
        count: what is written.
        place: where.
        number: of the marker, which differs for each region.
    """
    text = count_text(count)
    x, y, z = place.point.tolist()
    # A marker lies at the middle of its text: raise it by half of the lines.
    lift = place.letter_m * (2 + text.count("\n") / 2)
    return Marker(
        header=count.header, ns="count", id=number, type=Marker.TEXT_VIEW_FACING,
        pose=Pose(position=Point(x=x, y=y, z=z + lift)), scale=Vector3(z=place.letter_m),
        color=_to_color(_STATUS_COLORS[count.status]), text=text)


def visible_marker(count: StackCount, number: int = 0) -> Marker:
    """Returns the outlines of the parts that show as lines; what takes them away where none do.

    Args:
        count: whose parts are shown.
        number: of the marker, which differs for each region.
    """
    if not any(len(part.outline.points) for part in count.visible_parts):
        return Marker(header=count.header, ns="visible_parts", id=number, action=Marker.DELETE)
    outlines = [np.array([[p.x, p.y, p.z] for p in part.outline.points])
                for part in count.visible_parts]
    ends = np.concatenate([np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
                           for outline in outlines])
    return _line_marker("visible_parts", ends, YELLOW, count.header, number)


def count_text(count: StackCount) -> str:
    """Returns what a person reads beside the stack.

    That is the region's name, the count, its interval and a sentence for each reason that
    degrades it; or the error.
    """
    of_region = f"{count.region}: " if count.region else ""
    if count.error:
        return "\n".join(textwrap.wrap(of_region + count.error, SETTINGS.line_length))
    parts = f"{count.count} part{'s' if count.count != 1 else ''}"
    lines = [f"{of_region}{parts} ({count.count_low} to {count.count_high}, "
             f"{count.confidence:.0%})"]
    for reason in from_reasons(count.reasons):
        if reason.degrades:
            lines += textwrap.wrap(reason.sentence, SETTINGS.line_length)
    return "\n".join(lines)


def _to_points(values: np.ndarray) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in values.astype(float).tolist()]


def _to_color(rgb: tuple[float, ...] | list[float]) -> ColorRGBA:
    return ColorRGBA(r=rgb[0], g=rgb[1], b=rgb[2], a=1.0)
