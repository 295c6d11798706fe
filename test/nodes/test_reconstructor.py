# SPDX-License-Identifier: Apache-2.0
"""The reconstructor over real DDS."""

import json
from pathlib import Path

import pytest
from kits.analytic import Scene
from kits.harness import LATCHED
from kits.painted import marks, painted, unlabelled
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from stack_counter_msgs.msg import PosedImage, ScanStatus, StackCount, StackVolume
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from stack_counter.ros.conversions import to_posed_image

SPACE = "/stack_counter"


@pytest.fixture(scope="module")
def ros(ros_of_module):
    return ros_of_module


@pytest.fixture(scope="module")
def reconstructor(ros):
    ros.start("reconstructor", report_folder=ros.folder / "reports")
    images = ros.node.create_publisher(PosedImage, f"{SPACE}/posed_images", QoSProfile(depth=100))
    status = ros.node.create_publisher(ScanStatus, f"{SPACE}/scan_status", QoSProfile(depth=100))
    ros.wait_for_subscribers(images, status)
    volumes = ros.collect_messages(StackVolume, f"{SPACE}/volume", LATCHED)

    def scan(views, name, announced=None):
        done = len(volumes)
        status.publish(ScanStatus(node="collector", scan_id=name, state=ScanStatus.SCANNING))
        for view in views:
            images.publish(to_posed_image(view, "base_link", name, "nut", 1e-6))
        stop = ScanStatus(node="collector", scan_id=name, state=ScanStatus.STOPPED,
                          received=len(views) + 1, skip_reasons=["blurred"], skip_counts=[1],
                          processed=len(views) if announced is None else announced)
        stop.header.frame_id = "base_link"
        status.publish(stop)
        # On a busy machine there are running volumes before it.
        ros.wait(lambda: any(v.final for v in volumes[done:]), f"the volume of scan {name}")
        assert volumes[-1].scan_id == name
        return volumes[-1]

    return scan


def test_a_report_is_written_on_request_below_the_configured_folder(ros, reconstructor):
    """The first test: at its start nothing was counted yet."""
    counts = ros.node.create_publisher(StackCount, f"{SPACE}/count", LATCHED)

    def ask():
        return ros.call(Trigger, f"{SPACE}/write_report", Trigger.Request())

    def expect(words):
        ros.wait(lambda: words in ask().message, f"an answer with '{words}'")
        assert not ask().success

    expect("nothing was counted yet")
    box = Scene().box([0.02, 0.01, 0.03], [0.2, 0.15, 0.06], 0.3)
    volume = reconstructor(box.views(4), "../../x")
    expect("not counted yet")
    counts.publish(StackCount(header=volume.header, scan_id=volume.scan_id, final=True, count=412,
                              count_low=391, count_high=430, confidence=0.9))
    ros.wait(lambda: ask().success, "a report")
    made = Path(ask().message)
    assert made.parent == ros.folder / "reports"
    assert made.name.startswith("report_19700101-000003-000_-x")
    result = json.loads((made / "result.json").read_text())
    assert (result["count"], result["volume_m3"]) == (412, volume.stack_volume)
    assert (made / "surface.ply").stat().st_size > 10_000  # only the reconstructor has the mesh
    assert {"surface.png", "top_surface.png"} <= {p.name for p in made.iterdir()}


def test_volume_of_a_box_is_right_and_the_next_scan_starts_anew(reconstructor):
    box = Scene().box([0.02, 0.01, 0.03], [0.2, 0.15, 0.06], 0.3)
    first = reconstructor(box.views(6), "one")
    assert first.final and not first.error
    assert first.stack_volume == pytest.approx(0.2 * 0.15 * 0.06, rel=0.03)
    assert (first.views.received, first.views.used) == (7, 6)
    assert list(first.views.skip_reasons) == ["blurred"]
    assert first.header.frame_id == "base_link" and first.header.stamp.sec == 5
    low = Scene().box([0, 0, 0.015], [0.2, 0.15, 0.03])
    second = reconstructor(low.views(6), "one")  # a name used twice is no reason to add up
    assert second.stack_volume == pytest.approx(0.2 * 0.15 * 0.03, rel=0.04)


def test_too_few_views_say_so_and_lost_ones_are_named(reconstructor):
    box = Scene().box([0.0, 0.0, 0.03], [0.2, 0.15, 0.06])
    few = reconstructor(box.views(2), "few")
    assert "2 views used" in few.error and "expected at least 3" in few.error
    assert few.header.frame_id == "base_link"
    lost = reconstructor(box.views(4), "lost", announced=5)
    # A block with walls so smooth may as well be a full bin.
    assert {"container_unsure", "views_lost"} <= set(lost.reasons)


def test_what_is_shown_is_latched_and_goes_with_the_next_scan(ros, reconstructor):
    views = Scene().bin((0.2, 0.15, 0.1), 0.005, 0.005, 0.05).views(6)
    volume = reconstructor(views, "bin")
    shown = ros.collect_messages(MarkerArray, f"{SPACE}/markers", LATCHED)
    clouds = ros.collect_messages(PointCloud2, f"{SPACE}/surface", LATCHED)
    ros.wait(lambda: any(m.ns == "container" for s in shown[-1:] for m in s.markers) and any(
        cloud.header == volume.header for cloud in clouds[-1:]), "what was published before")
    first, *markers = shown[-1].markers
    assert first.action == Marker.DELETEALL
    assert [m.ns for m in markers] == ["container", "region", "cameras", "surface"]
    assert all(m.header == volume.header for m in markers)
    wall = [p.z for p in markers[0].points]
    assert min(wall) == pytest.approx(0.005, abs=0.003)  # the floor
    assert max(wall) == pytest.approx(0.105, abs=0.003)  # the rim
    eyes = [(p.x, p.y, p.z) for p in markers[2].points[::16]]  # a camera has eight lines
    assert eyes == [pytest.approx(v.T_world_camera[:3, 3], abs=0.005) for v in views]
    assert len(markers[3].points) % 3 == 0 < clouds[-1].width
    assert [f.name for f in clouds[-1].fields] == ["x", "y", "z", "rgb"]
    reconstructor(views[:2], "few")  # which gives no volume
    ros.wait(lambda: [m.ns for m in shown[-1].markers] == ["", "cameras"], "only the cameras")
    ros.wait(lambda: clouds[-1].width == 0, "an empty cloud")


def test_prompts_by_the_parameter_service_hold_from_the_next_scan_on(ros, reconstructor):
    def set_prompts(document):
        value = Parameter("prompts", value=json.dumps(document)).to_parameter_msg()
        return ros.call(SetParameters, f"{SPACE}/reconstructor/set_parameters",
                        SetParameters.Request(parameters=[value])).results[0]

    views = painted(depth=False)
    assert "no_depth" in reconstructor(unlabelled(views), "plain").error
    bad = set_prompts({"part": {}})
    assert not bad.successful and "unknown key 'part'" in bad.reason
    assert set_prompts(marks(views[0].labels)).successful
    volume = reconstructor(unlabelled(views), "marked")
    assert not volume.error and volume.has_key_view
