# SPDX-License-Identifier: Apache-2.0
"""The collector over real DDS: what comes in, what goes on, and that nothing is lost."""

import signal

from diagnostic_msgs.msg import DiagnosticArray
from kits.harness import PATIENCE_S, Camera
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CompressedImage
from stack_counter_msgs.msg import PosedImage, ScanStatus
from stack_counter_msgs.srv import StartScan, StopScan
from std_srvs.srv import Trigger

from stack_counter.parts.catalogue import Part, save_part
from stack_counter.types import Intrinsics

SPACE = "/stack_counter"


def test_poses_are_interpolated_and_skips_are_counted(ros):
    collector = ros.start("collector", depth_topic="''", tf_timeout_s=0.5)
    images = ros.collect_messages(PosedImage, f"{SPACE}/posed_images")
    greet = ros.node.create_publisher(ScanStatus, f"{SPACE}/scan_status", QoSProfile(depth=10))
    ros.wait_for_subscribers(greet)
    ros.wait(lambda: ros.node.count_publishers(f"{SPACE}/posed_images"), "the collector's topic")
    states = ros.collect_messages(ScanStatus, f"{SPACE}/scan_status")
    publish = Camera(ros)
    greet.publish(ScanStatus(node="reconstructor"))
    answer = ros.call(StartScan, f"{SPACE}/start_scan",
                      StartScan.Request(scan_id="a", part="nut", unit_volume=2e-6,
                                        part_size=[0.03, 0.02, 0.01]))
    assert answer.accepted and answer.scan_id == "a" and not answer.unmatched_topics
    assert not ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request()).accepted
    publish(0)
    publish(1, with_tf=False)
    publish(2)
    ros.wait(lambda: len(images) == 2, "two posed images")
    ros.wait(lambda: states[-1].received == 3 and sum(states[-1].skip_counts) == 1, "one skip")
    assert list(states[-1].skip_reasons) == ["no_tf"]
    assert (images[0].scan_id, images[0].part, images[0].unit_volume) == ("a", "nut", 2e-6)
    assert list(images[0].part_size) == [0.03, 0.02, 0.01]
    assert abs(images[1].pose.position.x - 0.02) < 1e-9  # halfway between its two samples
    stop_after_what_was_sent(ros, collector, lambda: [publish(i) for i in range(3, 9)], 2 + 6)
    assert not ros.call(StopScan, f"{SPACE}/stop_scan", StopScan.Request()).accepted
    assert ros.log("collector").count("scan 'a' opened: part 'nut'\n") == 1
    ros.call(Trigger, f"{SPACE}/reset", Trigger.Request())
    assert "scan 'a' lost: reset was called\n" in ros.log("collector")


def stop_after_what_was_sent(ros, collector, send, expected):
    """What was sent before the stop belongs to the scan, though the collector stands still."""
    stop = ros.node.create_client(StopScan, f"{SPACE}/stop_scan")
    assert stop.wait_for_service(PATIENCE_S)
    collector.send_signal(signal.SIGSTOP)
    send()
    answer = stop.call_async(StopScan.Request())
    collector.send_signal(signal.SIGCONT)
    ros.wait(answer.done, "an answer of stop_scan")
    assert (answer.result().accepted, answer.result().published) == (True, expected)


def test_no_image_is_lost_at_1280x720(ros):
    ros.start("collector", depth_topic="''", color_transport="raw")
    assert_the_other_transport_is_named(ros)
    images = []
    status = ros.node.create_publisher(ScanStatus, f"{SPACE}/scan_status", QoSProfile(depth=100))

    def on_image(message):  # plays the reconstructor, which reports what it has taken
        images.append(message.header.stamp.sec)
        status.publish(ScanStatus(node="reconstructor", scan_id=message.scan_id,
                                  received=len(images)))

    ros.node.create_subscription(PosedImage, f"{SPACE}/posed_images", on_image,
                                 QoSProfile(depth=100))
    publish = Camera(ros, Intrinsics(1280, 720, 900.0, 900.0, 639.5, 359.5))
    ros.wait_for_subscribers(status)
    status.publish(ScanStatus(node="reconstructor"))
    ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(scan_id="b"))
    for i in range(200):
        ros.wait(lambda i=i: i - len(images) < 8, f"image {i - 8} of 200")
        publish(i)
    ros.wait(lambda: len(images) == 200, "200 posed images")
    assert images == list(range(1, 201))
    assert ros.call(StopScan, f"{SPACE}/stop_scan", StopScan.Request()).published == 200


def assert_the_other_transport_is_named(ros):
    """Nobody publishes raw images, and somebody compressed ones."""
    diagnostics = ros.collect_messages(DiagnosticArray, "/diagnostics")
    camera = ros.node.create_publisher(CompressedImage, "/camera/color/image_raw/compressed", 1)
    line = ("/camera/color/image_raw/compressed has 1 publisher: set color_transport: compressed "
            "(or auto)")
    ros.wait(lambda: any(line in s.message for m in diagnostics for s in m.status),
             "the other transport in the diagnostics")
    states = ros.collect_messages(ScanStatus, f"{SPACE}/scan_status")
    started = ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(
        part="nut", unit_volume=2e-6))
    assert (started.accepted, started.message) == (True, line)
    stopped = ros.call(StopScan, f"{SPACE}/stop_scan", StopScan.Request())
    assert (stopped.published, stopped.message) == (0, line)
    ros.wait(lambda: states and states[-1].state == ScanStatus.STOPPED, "the end of the scan")
    assert (states[-1].part, states[-1].unit_volume) == ("nut", 2e-6)
    assert states[-1].problems == [line]
    ros.node.destroy_publisher(camera)
    ros.call(Trigger, f"{SPACE}/reset", Trigger.Request())


def test_a_configured_part_has_the_v_of_the_catalogue(ros, tmp_path):
    catalogue = tmp_path / "parts.yaml"
    save_part(Part(2e-6, "nut"), catalogue)
    ros.start("collector", depth_topic="''", mode="continuous", part="nut",
              part_catalogue=catalogue)
    images = ros.collect_messages(PosedImage, f"{SPACE}/posed_images")
    greet = ros.node.create_publisher(ScanStatus, f"{SPACE}/scan_status", QoSProfile(depth=10))
    ros.wait_for_subscribers(greet)
    ros.wait(lambda: ros.node.count_publishers(f"{SPACE}/posed_images"), "the collector's topic")
    publish = Camera(ros, wait_for_collector=False)  # which would start a scan of no part
    for publisher in (publish.color, publish.info, publish.tf):
        ros.wait_for_subscribers(publisher)
    greet.publish(ScanStatus(node="reconstructor"))
    number = iter(range(1000))
    ros.wait(lambda: images or publish(next(number)), "an image")
    assert (images[0].part, images[0].unit_volume) == ("nut", 2e-6)
