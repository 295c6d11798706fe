"""What RViz and Foxglove show: container, region, cameras, surface and count, as messages."""

from __future__ import annotations

import textwrap

import numpy as np
from geometry_msgs.msg import Point, Pose, Vector3
from sensor_msgs.msg import PointCloud2, PointField
from stack_counter_msgs.msg import StackCount
from stack_counter_msgs.msg import StackVolume as StackVolumeMsg
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from stack_counter.display.mesh_colors import display_colors
from stack_counter.display.mesh_decimation import decimated
from stack_counter.display.wireframes import box_lines, container_lines, frustum_lines
from stack_counter.ros.conversions import from_container, from_height_map
from stack_counter.ros.standard_messages import to_bytes
from stack_counter.types import Mesh, StackVolume, View

# A triangle takes 120 bytes (three points of 24, three colours of 16): 2.4 MB. The cloud has all.
MOST_TRIANGLES = 20_000
_FRUSTUM_M = 0.06  # how far a camera's pyramid is drawn: beside a bin that is small but seen
_LINE_M = 0.002
_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])

ORANGE, WHITE, BLUE = (1.0, 0.6, 0.1), (0.8, 0.8, 0.8), (0.2, 0.6, 1.0)
GREEN, RED = (0.3, 0.9, 0.3), (1.0, 0.25, 0.2)
_STATUS = {StackCount.STATUS_OK: GREEN, StackCount.STATUS_DEGRADED: ORANGE,
           StackCount.STATUS_ERROR: RED}
_LINE_LENGTH = 40  # letters of an error before it is broken


def scene_markers(volume: StackVolume | None, region: tuple[np.ndarray, np.ndarray] | None,
                  views: list[View], header: Header) -> MarkerArray:
    """What there is of a scan: namespaces `container`, `region`, `cameras` and `surface`.

    Args:
        volume: None where the scan gave none.
        region: low and high corner (3,) of the region of interest, world, metres; None if there
            is none.
        views: whose cameras are drawn.
        header: world frame, stamp of the data.
    """
    # First of all the last scan's go: this one may have less to show.
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    if volume is not None:
        markers.append(_lines("container", container_lines(volume.container), ORANGE, header))
    if region is not None:
        markers.append(_lines("region", box_lines(*region), WHITE, header))
    frusta = [frustum_lines(v.intrinsics, v.T_world_camera, _FRUSTUM_M) for v in views]
    markers.append(_lines("cameras", np.array(frusta), BLUE, header))
    if volume is not None and volume.mesh is not None and len(volume.mesh.triangles):
        markers.append(surface_marker(volume.mesh, header))
    # A marker without points is an error in both viewers.
    return MarkerArray(markers=[m for m in markers if m.action != Marker.ADD or m.points])


def _lines(ns: str, ends: np.ndarray, rgb: tuple[float, float, float], header: Header) -> Marker:
    """Marker of (..., 2, 3) ends of lines, world, metres."""
    return Marker(header=header, ns=ns, type=Marker.LINE_LIST, scale=Vector3(x=_LINE_M),
                  color=_color(rgb), points=_points(ends.reshape(-1, 3)))


def surface_marker(mesh: Mesh, header: Header) -> Marker:
    """The surface as triangles, at most `MOST_TRIANGLES`, with a colour for each corner: Foxglove
    takes none for faces."""
    mesh = decimated(mesh, MOST_TRIANGLES)
    corners = mesh.triangles.ravel().tolist()
    points = _points(mesh.vertices)  # one message a vertex, which its triangles share
    colors = [_color(rgb) for rgb in (display_colors(mesh) / 255).tolist()]
    return Marker(header=header, ns="surface", type=Marker.TRIANGLE_LIST,
                  scale=Vector3(x=1.0, y=1.0, z=1.0), color=_color(WHITE),
                  points=[points[i] for i in corners], colors=[colors[i] for i in corners])


def surface_points(mesh: Mesh | None, header: Header) -> PointCloud2:
    """The surface's vertices as a cloud of x, y, z (float32, metres, world) and rgb: 0x00rrggbb
    in a float's place, as point clouds have it; no points for None."""
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


def text_place(volume: StackVolumeMsg) -> tuple[np.ndarray, float] | None:
    """Where the count is written, and how large: the highest point (3,) of container and stack
    above their middle, world, metres, and a tenth of their width, metres; None if the volume
    has neither."""
    if volume.error:
        return None
    box, top = from_container(volume.container), from_height_map(volume.top)
    like_a_cube = max(volume.stack_volume, 0.0) ** (1 / 3)
    height, width = box.outer_size_m[2], max(box.outer_size_m[:2])
    if top is not None and np.isfinite(top.heights).any():
        height = max(height, float(np.nanmax(top.heights)))
        width = width or max(top.heights.shape) * top.pitch
    T = box.T_world_container
    return (T[:3, 3] + T[:3, 2] * (height or like_a_cube / 2),
            float(np.clip((width or like_a_cube) / 10, 0.01, 0.1)))


def count_markers(count: StackCount, top: np.ndarray, letter: float) -> MarkerArray:
    """The count as text above a point, coloured by its status; or the error.

    Args:
        count: result.
        top: (3,) what the text stands above, world, metres.
        letter: height of a letter, metres.
    """
    text = count_text(count)
    x, y, z = top.tolist()  # the text's middle is where the marker is
    pose = Pose(position=Point(x=x, y=y, z=z + letter * (2 + text.count("\n") / 2)))
    return MarkerArray(markers=[Marker(
        header=count.header, ns="count", type=Marker.TEXT_VIEW_FACING, pose=pose,
        scale=Vector3(z=letter), color=_color(_STATUS[count.status]), text=text)])


def count_text(count: StackCount) -> str:
    """What a person reads beside the stack."""
    if count.error:
        return "\n".join(textwrap.wrap(count.error, _LINE_LENGTH))
    lines = [f"{count.count} part{'s' if count.count != 1 else ''} ({count.count_low} to "
             f"{count.count_high}, {count.confidence:.0%})"]
    if count.status == StackCount.STATUS_DEGRADED:
        lines += textwrap.wrap(", ".join(count.reasons), _LINE_LENGTH)
    return "\n".join(lines)


def _points(values: np.ndarray) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in values.astype(float).tolist()]


def _color(rgb: tuple[float, ...] | list[float]) -> ColorRGBA:
    return ColorRGBA(r=rgb[0], g=rgb[1], b=rgb[2], a=1.0)
