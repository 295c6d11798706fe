"""What RViz and Foxglove show: the container as a wire box, the surface as points."""

from __future__ import annotations

import itertools

import numpy as np
from geometry_msgs.msg import Point
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from stack_counter.nodes.conversions import to_bytes, to_pose
from stack_counter.types import Container, Mesh


def container_markers(container: Container, header: Header) -> MarkerArray:
    """The inner edges of a box; deletes the last marker for other kinds."""
    marker = Marker(header=header, ns="container", id=0, type=Marker.LINE_LIST,
                    action=Marker.ADD if container.kind == "box" else Marker.DELETE,
                    pose=to_pose(container.T_world_container),
                    color=ColorRGBA(r=1.0, g=0.6, b=0.1, a=1.0))
    marker.scale.x = 0.002
    x, y, depth = container.inner_size_m
    corners = [(sx * x / 2, sy * y / 2, container.floor_thickness_m + up * depth)
               for sx, sy, up in itertools.product((-1, 1), (-1, 1), (0, 1))]
    for a, b in itertools.combinations(corners, 2):
        if sum(p != q for p, q in zip(a, b)) == 1:  # an edge: the ends differ on one axis
            marker.points += [Point(x=a[0], y=a[1], z=a[2]), Point(x=b[0], y=b[1], z=b[2])]
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
