"""What RViz and Foxglove show: the container as wire, the surface as points."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from stack_counter.nodes.conversions import to_bytes, to_pose
from stack_counter.types import Container, Mesh

_WIRES = 12  # lines from floor to rim


def container_markers(container: Container, header: Header) -> MarkerArray:
    """The inner wall as wire: rim, floor and lines between; deletes the last marker where there
    is none."""
    marker = Marker(header=header, ns="container", id=0, type=Marker.LINE_LIST,
                    action=Marker.DELETE if container.rings is None else Marker.ADD,
                    pose=to_pose(container.T_world_container),
                    color=ColorRGBA(r=1.0, g=0.6, b=0.1, a=1.0))
    marker.scale.x = 0.002
    if container.rings is not None:
        rings = container.rings[container.rings[:, 0, 2] >= container.floor_thickness_m]
        lines = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings[[0, -1]]]
        walls = rings[:, ::max(rings.shape[1] // _WIRES, 1)]  # (k, w, 3)
        lines.append(np.stack([walls[:-1], walls[1:]], axis=2).reshape(-1, 2, 3))
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in
                         np.concatenate(lines).reshape(-1, 3).tolist()]
    return MarkerArray(markers=[marker])


def surface_points(mesh: Mesh, header: Header) -> PointCloud2:
    """The surface's vertices as a cloud of x, y, z (float32, metres, world)."""
    points = np.ascontiguousarray(mesh.vertices, np.float32)
    fields = [PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
              for i, name in enumerate("xyz")]
    cloud = PointCloud2(header=header, height=1, width=len(points), fields=fields,
                        point_step=12, row_step=12 * len(points), is_dense=True)
    cloud.data = to_bytes(points)
    return cloud
