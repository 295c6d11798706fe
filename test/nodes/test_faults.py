# SPDX-License-Identifier: Apache-2.0
"""Faults that a cell has, over real DDS: nothing hangs, what is lost is said, the next scan is
right."""

import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from kits.harness import FRAME, PATIENCE_S, Camera, StandInReconstructor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from stack_counter_msgs.msg import ScanStatus
from stack_counter_msgs.srv import StartScan, StopScan
from tf2_msgs.msg import TFMessage

from stack_counter.ros.standard_messages import to_header, to_image
from stack_counter.types import Intrinsics

SPACE = "/stack_counter"
HD = Intrinsics(1280, 720, 900.0, 900.0, 639.5, 359.5)


class Cell:
    """A collector and what is seen of it."""

    def __init__(self, ros, **settings):
        self.ros = ros
        self.process = ros.start("collector", depth_topic="''", **settings)
        self.states = ros.collect_messages(ScanStatus, f"{SPACE}/scan_status")
        self.diagnostics = ros.collect_messages(DiagnosticArray, "/diagnostics")

    def start(self, scan_id):
        answer = self.ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(
            scan_id=scan_id))
        assert answer.accepted, answer.message

    def stop(self):
        return self.ros.call(StopScan, f"{SPACE}/stop_scan", StopScan.Request()).published

    def skipped(self, scan_id):
        """Skip reasons that the collector has said of a scan."""
        of = [s for s in self.states if s.node == "collector" and s.scan_id == scan_id]
        return dict(zip(of[-1].skip_reasons, of[-1].skip_counts)) if of else {}

    def status(self):
        """What the collector last said of itself."""
        said = [s for m in self.diagnostics for s in m.status
                if s.name == "stack_counter: collector"]
        return said[-1] if said else DiagnosticStatus()

    def counts_again(self, camera, taker, scan_id="next"):
        """The next scan is right, whatever came before."""
        before = len(taker.images)
        self.start(scan_id)
        for i in range(1000, 1003):
            camera(i)
        self.ros.wait(lambda: len(taker.images) == before + 3, "three views of the next scan")
        assert self.stop() == 3


def test_a_flood_of_large_images_is_bounded_and_counted(ros):
    cell = Cell(ros)
    camera = Camera(ros, HD)
    cell.start("flood")
    for i in range(100):  # nobody takes them: there is no reconstructor
        camera(i)
        ros.wait(lambda i=i: cell.states and cell.states[-1].received >= i - 20, "images taken")
    ros.wait(lambda: cell.states[-1].received == 100 == cell.states[-1].processed
             + sum(cell.states[-1].skip_counts), "every image kept or given up")
    kept = cell.states[-1].processed
    assert 0 < kept <= 60
    ros.wait(lambda: cell.status().values, "diagnostics")
    assert float({v.key: v.value for v in cell.status().values}["memory MB"]) < 2000
    cell.stop()
    taker = StandInReconstructor(ros)
    ros.wait(lambda: len(taker.images) == kept, "the views that were kept")
    cell.counts_again(camera, taker)


def test_a_camera_that_stops_is_named(ros):
    cell = Cell(ros)
    camera, taker = Camera(ros), StandInReconstructor(ros)
    cell.start("silent")
    camera(0)
    ros.wait(lambda: cell.status().level == DiagnosticStatus.WARN, "a warning")
    assert "no image on /camera/color/image_raw" in cell.status().message
    cell.stop()
    cell.counts_again(camera, taker)


def test_another_resolution_in_mid_scan(ros):
    cell = Cell(ros)
    camera, taker = Camera(ros), StandInReconstructor(ros)
    cell.start("sizes")
    camera(0)
    camera(1, k=HD)
    header = to_header(3 * 10**9, FRAME)
    camera(2, k=HD, image=to_image(camera.picture(camera.k), "rgb8", header))  # only its info
    ros.wait(lambda: cell.skipped("sizes") == {"size_mismatch": 1}, "a skip")
    ros.wait(lambda: [(m.color.width, m.color.height) for m in taker.images] == [
        (64, 48), (1280, 720)], "both sizes")
    cell.stop()
    cell.counts_again(camera, taker)


def test_tf_that_comes_late_stops_or_jumps(ros):
    cell = Cell(ros, tf_timeout_s=4.0)
    camera, taker = Camera(ros), StandInReconstructor(ros)
    cell.start("tf")
    camera(0, with_tf=False)
    ros.wait(lambda: cell.status().values, "a second")
    camera.publish_pose(0, -20_000_000)
    camera.publish_pose(0, 20_000_000)  # late, but within the timeout
    ros.wait(lambda: len(taker.images) == 1, "the view that waited for its pose")
    camera(1, with_tf=False)
    camera.publish_pose(0, 500_000_000)
    camera.publish_pose(2, -500_000_000)  # another pose, too far apart to interpolate in
    ros.wait(lambda: cell.skipped("tf") == {"no_tf": 1}, "a skip")
    camera(2, with_tf=False)  # and none at all
    ros.wait(lambda: cell.skipped("tf") == {"no_tf": 2}, "another")
    cell.stop()
    cell.counts_again(camera, taker)


def test_a_clock_that_jumps_back(ros):
    cell = Cell(ros)
    camera, taker = Camera(ros), StandInReconstructor(ros)
    cell.start("loop")
    for turn in range(2):
        for i in range(100, 105):
            camera(i)
        ros.wait(lambda turn=turn: len(taker.images) == 5 + 4 * turn, f"turn {turn}")
    assert cell.skipped("loop") == {"time_backwards": 1}
    cell.stop()
    cell.counts_again(camera, taker)


def test_a_publisher_of_another_qos_is_an_error_that_says_so(ros):
    cell = Cell(ros)
    Camera(ros, qos=QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT),
           wait_for_collector=False)
    ros.wait(lambda: cell.status().level == DiagnosticStatus.ERROR, "an error")
    assert "another QoS" in cell.status().message and "reliable" in cell.status().message


def bad_images():
    """Colour images that no camera should send."""
    header = to_header(10**9, FRAME)
    good = to_image(np.zeros((48, 64, 3), np.uint8), "rgb8", header)
    for name, value in (("width", 0), ("step", 7), ("encoding", "nonsense"), ("height", 2**31),
                        ("data", b"")):
        bad = Image(header=header, height=good.height, width=good.width, step=good.step,
                    encoding=good.encoding, data=good.data)
        setattr(bad, name, value)
        yield bad


def test_malformed_messages_are_skipped_and_the_node_stays_up(ros):
    cell = Cell(ros)
    camera, taker = Camera(ros), StandInReconstructor(ros)
    cell.start("bad")
    for i, bad in enumerate(bad_images()):
        bad.header = to_header((i + 1) * 10**9, FRAME)
        camera(i, image=bad)
    camera(5)
    for number, change in enumerate(({"x": float("nan")}, {"w": 3.0}, {"w": 0.0})):
        t = TFMessage()
        camera.tf.publish(t)  # none at all
        from geometry_msgs.msg import TransformStamped

        pose = TransformStamped(header=to_header((number + 7) * 10**9, "base_link"),
                                child_frame_id=FRAME)
        for key, value in change.items():
            setattr(pose.transform.rotation if key == "w" else pose.transform.translation, key,
                    value)
        camera.tf.publish(TFMessage(transforms=[pose]))
    ros.wait(lambda: sum(cell.skipped("bad").values()) == 5, "five skips")
    ros.wait(lambda: len(taker.images) == 1, "the good one")
    unknown = ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(part="no such part"))
    assert not unknown.accepted
    cell.stop()
    refused = ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(part="no such part"))
    assert not refused.accepted and "unknown part" in refused.message
    cell.counts_again(camera, taker)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_cleanly(ros, number):
    cell = Cell(ros)
    camera = Camera(ros)
    cell.start("ends")
    camera(0)
    ros.wait(lambda: cell.states and cell.states[-1].received == 1, "a view")
    ros.processes.remove(cell.process)
    cell.process.send_signal(number)
    assert cell.process.wait(PATIENCE_S) == 0
    assert "Traceback" not in ros.log("collector")
