# SPDX-License-Identifier: Apache-2.0
"""The reconstructor over real DDS."""

import json
import signal
import threading
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
from stack_counter.types import PartRequest

SPACE = "/stack_counter"


@pytest.fixture(scope="module")
def ros(ros_of_module):
    return ros_of_module


class Collector:
    """Sends scans to a reconstructor as the collector does."""

    def __init__(self, ros):
        self.ros = ros
        self.process = ros.start("reconstructor", report_folder=ros.folder / "reports")
        self._images = ros.node.create_publisher(PosedImage, f"{SPACE}/posed_images",
                                                 QoSProfile(depth=100))
        self._status = ros.node.create_publisher(ScanStatus, f"{SPACE}/scan_status",
                                                 QoSProfile(depth=100))
        ros.wait_for_subscribers(self._images, self._status)
        self._volumes = ros.collect_messages(StackVolume, f"{SPACE}/volume", LATCHED)
        # The collector announces an end until there is a result.
        self._stop = ScanStatus()
        ros.node.create_timer(0.6, lambda: self._stop.scan_id and self._status.publish(self._stop))

    def send(self, views, name):
        for view in views:
            self._images.publish(to_posed_image(view, "base_link", name,
                                                PartRequest("nut", 1e-6)))

    def stop(self, views, name, problems=()):
        """Announces the end of a scan of so many views."""
        self._done = len(self._volumes)
        self._stop = ScanStatus(node="collector", scan_id=name, state=ScanStatus.STOPPED,
                                received=views + 1, skip_reasons=["blurred"], skip_counts=[1],
                                processed=views, part="nut", unit_volume=1e-6,
                                problems=problems)
        self._stop.header.frame_id = "base_link"
        self._status.publish(self._stop)

    def final_volume(self, name):
        # On a busy machine there are running volumes before it.
        self.ros.wait(lambda: any(v.final for v in self._volumes[self._done:]),
                      f"the volume of scan {name}")
        self._stop = ScanStatus()
        assert self._volumes[-1].scan_id == name
        return self._volumes[-1]

    def __call__(self, views, name, announced=None):
        self._status.publish(ScanStatus(node="collector", scan_id=name,
                                        state=ScanStatus.SCANNING))
        self.send(views, name)
        self.stop(len(views) if announced is None else announced, name)
        return self.final_volume(name)


@pytest.fixture(scope="module")
def reconstructor(ros):
    return Collector(ros)


def test_a_report_is_written_on_request_below_the_configured_folder(ros, reconstructor):
    """The first test: at its start nothing was counted yet."""
    counts = ros.node.create_publisher(StackCount, f"{SPACE}/result", LATCHED)

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


def test_volume_of_a_box_is_right_and_the_next_scan_starts_anew(ros, reconstructor):
    box = Scene().box([0.02, 0.01, 0.03], [0.2, 0.15, 0.06], 0.3)
    first = reconstructor(box.views(6), "one")
    assert first.final and not first.error
    assert first.stack_volume == pytest.approx(0.2 * 0.15 * 0.06, rel=0.03)
    assert (first.views.received, first.views.used) == (7, 6)
    assert list(first.views.skip_reasons) == ["blurred"]
    assert first.header.frame_id == "base_link" and first.header.stamp.sec == 5
    line = "scan 'one': 6 views used of 7; skipped: 1 blurred\n"
    ros.wait(lambda: ros.log("reconstructor").count(line) == 1, "a line about the views")
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
    assert dict(zip(lost.views.skip_reasons, lost.views.skip_counts)) == {
        "blurred": 1, "views_lost": 1}


def test_a_scan_without_views_names_its_part_and_what_keeps_them_away(reconstructor):
    reconstructor.stop(0, "empty", ["/c/compressed has 1 publisher"])
    volume = reconstructor.final_volume("empty")
    assert "0 views used" in volume.error and volume.error.endswith("; /c/compressed has 1 "
                                                                    "publisher")
    assert (volume.part, volume.unit_volume) == ("nut", 1e-6)


def test_images_that_wait_in_a_node_that_stood_still_are_not_lost(ros, reconstructor):
    """It gets no processor, for longer than images may be late, before the first one."""
    states = ros.collect_messages(ScanStatus, f"{SPACE}/scan_status")
    reconstructor.stop(4, "stopped")
    ros.wait(lambda: any(s.node == "reconstructor" and s.scan_id == "stopped" for s in states),
             "the scan without images")
    reconstructor.process.send_signal(signal.SIGSTOP)
    box = Scene().box([0.02, 0.01, 0.03], [0.2, 0.15, 0.06], 0.3)
    reconstructor.send(box.views(4), "stopped")
    threading.Event().wait(6.0)
    reconstructor.process.send_signal(signal.SIGCONT)
    volume = reconstructor.final_volume("stopped")
    assert volume.views.used == 4 and "views_lost" not in volume.reasons


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
