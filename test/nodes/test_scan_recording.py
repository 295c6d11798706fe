# SPDX-License-Identifier: Apache-2.0
"""The collector records its scans over real DDS: replayed they give the same, whatever happens."""

import json
import resource
import signal

import numpy as np
import pytest
from kits.bags import FRAME, bag, bin_views
from kits.harness import LATCHED
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import QoSProfile
from stack_counter_msgs.msg import PosedImage, ScanStatus, StackCount
from stack_counter_msgs.srv import StartScan, StopScan
from std_srvs.srv import Trigger

from stack_counter import geometry
from stack_counter.bag.bag_views import read_views
from stack_counter.bag.reader import BagReader
from stack_counter.cli import main
from stack_counter.config import CollectorConfig
from stack_counter.ros.standard_messages import message_type
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

SPACE = "/stack_counter"
RELIABLE = QoSProfile(depth=1000)
V_CM3 = 30.0


@pytest.fixture
def cell(ros, tmp_path):
    """A collector that records, and what a camera on a hand says of six views, by stamp."""
    return make_cell(ros, tmp_path, bin_views())


def make_cell(ros, tmp_path, views):
    hand_eye = geometry.look_at(np.array([0.01, 0.02, 0.3]), np.zeros(3))
    # Samples 60 ms apart: poses between them are interpolated.
    hand = [(v.stamp_ns + d, "base_link", "hand", v.T_world_camera @ geometry.inverse(hand_eye))
            for v in views for d in (-30_000_000, 30_000_000)]
    reader = BagReader(bag(tmp_path, views, transforms=hand, static=[(0, "hand", FRAME, hand_eye)],
                           compressed=False))
    return Cell(ros, tmp_path / "recordings", list(reader.records(set(reader.topics))),
                reader.topics)


class Cell:
    """What the tests do with it."""

    def __init__(self, ros, folder, records, topics):
        self.ros, self.folder, self.records = ros, folder, records
        self.states = ros.collect_messages(ScanStatus, f"{SPACE}/scan_status")
        self.publishers = {topic: ros.node.create_publisher(
            message_type(kind), topic, LATCHED if topic == "/tf_static" else RELIABLE)
            for topic, (kind, _) in topics.items()}

    def collect(self):
        process = self.ros.start("collector", record_folder=self.folder, tf_timeout_s=20.0)
        self.ros.wait_until_collector_receives(*self.publishers.values())
        return process

    def play(self, *topics, views=range(7)):
        """Publishes the records of these topics (none: all) that belong to these views; 0: what
        is static."""
        for record in self.records:
            number = (record.log_time_ns + 500_000_000) // 10**9
            if (not topics or record.topic in topics) and number in views:
                self.publishers[record.topic].publish(record.data)

    def start(self, scan_id):
        answer = self.ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(
            scan_id=scan_id, unit_volume=V_CM3 * 1e-6))
        assert answer.accepted, answer.message

    def stop(self):
        assert self.ros.call(StopScan, f"{SPACE}/stop_scan", StopScan.Request()).accepted

    def seen(self, count, scan_id):
        """Waits until the collector has decided so many images of a scan."""
        self.ros.wait(lambda: any(s.scan_id == scan_id and s.node == "collector"
                                  and s.processed + sum(s.skip_counts) == count
                                  for s in self.states), f"{count} views of {scan_id}")

    def file(self, pattern):
        """Waits for the one file of this name."""
        self.ros.wait(lambda: list(self.folder.glob(pattern)), pattern)
        path, = self.folder.glob(pattern)
        return path


def views_in(path):
    config = CollectorConfig()
    return [view for _, view in read_views(BagReader(path), RigAssembler(load_rig(config),
                                                                         live=False))]


def test_each_scan_replays_to_the_count_that_the_nodes_gave(cell, ros, tmp_path, capsys):
    cell.collect()
    ros.start("reconstructor")
    ros.start("counter", estimator="depth_corrected")
    counts = ros.collect_messages(StackCount, f"{SPACE}/result", LATCHED)
    ros.wait(lambda: any(s.node == "reconstructor" for s in cell.states), "the reconstructor")
    ros.wait(lambda: ros.node.count_subscribers(f"{SPACE}/volume"), "the counter")
    cell.play("/tf_static", "/camera/color/camera_info", views=[0, 1])  # once and for all
    cell.play("/tf", views=[1, 2, 3])
    for name, views in (("one", range(1, 7)), ("two", range(1, 5))):
        cell.start(name)
        cell.play("/tf", views=range(4, 7))
        cell.play("/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw",
                  views=views)
        cell.seen(len(views), name)
        cell.stop()
        cell.play("/camera/color/image_raw", views=[6])  # of no scan
        ros.wait(lambda n=name: any(c.scan_id == n and c.final for c in counts),
                 f"the count of {name}")
    counts = [count for count in counts if count.final]
    for message, name, used in ((counts[-2], "one", 6), (counts[-1], "two", 4)):
        assert not message.error and message.count > 0
        out = tmp_path / f"{name}.json"
        path = cell.file(f"scan_*_{name}.mcap")
        assert main(["replay", str(path), "--unit-volume-cm3", str(V_CM3), "--direct",
                     "--estimator", "depth_corrected", "--json", str(out)]) == 0
        again = json.loads(out.read_text())
        assert again["views"] == {"received": used, "used": used, "skipped": {}}
        assert (again["count"], again["count_interval"]) == (
            message.count, [message.count_low, message.count_high])
        assert again["volume_m3"] == pytest.approx(message.stack_volume, rel=1e-9)
        assert again["gamma"] == pytest.approx(message.gamma, rel=1e-9)
        assert "bag_truncated" not in again["reasons"]
        assert BagReader(path).facts["ended"] == "stop_scan"
    assert counts[-1].stack_volume != counts[-2].stack_volume


def test_views_that_a_scan_had_no_time_for_are_not_counted_on_replay(ros, tmp_path):
    cell = make_cell(ros, tmp_path, bin_views(count=64))
    cell.collect()  # no one takes its views: 60 of them wait
    cell.start("slow")
    for i in range(65):
        cell.play(views=[i])
        cell.seen(i, "slow")
    last = cell.states[-1]
    assert dict(zip(last.skip_reasons, last.skip_counts)) == {"overrun": 4}
    cell.stop()
    path, out = cell.file("scan_*_slow.mcap"), tmp_path / "slow.json"
    assert main(["replay", str(path), "--unit-volume-cm3", str(V_CM3), "--direct",
                 "--estimator", "prior", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["views"] == {
        "received": 64, "used": 60, "skipped": {"overrun": 4}}
    assert BagReader(path).overrun == {(FRAME, i * 10**9) for i in range(1, 5)}


def test_a_killed_collector_leaves_its_views_and_the_next_one_goes_on(cell, ros):
    process = cell.collect()
    cell.start("dead")
    cell.play(views=[0, 1, 2, 3])
    cell.seen(3, "dead")
    part = cell.file("scan_*_dead.mcap.part")
    ros.wait(lambda: len(views_in(part)) == 3, "the file")
    ros.processes.remove(process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert [v.stamp_ns for v in views_in(part)] == [10**9, 2 * 10**9, 3 * 10**9]
    ros.start("collector", record_folder=cell.folder)
    left = cell.file("scan_*_dead.cut.mcap")
    assert len(views_in(left)) == 3 and BagReader(left).truncated and not part.exists()
    ros.wait(lambda: left.name in ros.log("collector"), "a warning")


def test_what_ends_a_scan_finishes_its_file(cell, ros):
    process = cell.collect()
    cell.start("reset")
    cell.play()
    cell.seen(6, "reset")
    ros.call(Trigger, f"{SPACE}/reset", Trigger.Request())
    for name, transition in (("off", Transition.TRANSITION_DEACTIVATE),
                             ("clean", Transition.TRANSITION_CLEANUP)):
        if name == "off":
            cell.start("off")
        request = ChangeState.Request(transition=Transition(id=transition))
        assert ros.call(ChangeState, f"{SPACE}/collector/change_state", request).success
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert ros.call(ChangeState, f"{SPACE}/collector/change_state", request).success
    ros.wait_until_collector_receives(*cell.publishers.values())
    cell.start("end")
    cell.play()
    cell.seen(6, "end")
    ros.processes.remove(process)
    process.send_signal(signal.SIGINT)
    process.wait(60)
    for name, ended, views in (("reset", "reset", 6), ("off", "deactivated", 0),
                               ("end", "shutdown", 6)):
        path = cell.file(f"scan_*_{name}.mcap")
        reader = BagReader(path)
        assert (reader.facts["ended"], reader.truncated) == (ended, False)
        assert len(views_in(path)) == views
    assert not list(cell.folder.glob("*.part"))


def test_a_full_disk_costs_the_scan_nothing(cell, ros):
    process = cell.collect()
    images = ros.collect_messages(PosedImage, f"{SPACE}/posed_images")
    greet = ros.node.create_publisher(ScanStatus, f"{SPACE}/scan_status", RELIABLE)
    ros.wait_for_subscribers(greet)
    greet.publish(ScanStatus(node="reconstructor"))
    before = resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (4000, -1))
    cell.start("full")
    cell.play(views=[0, 1, 2, 3, 4])
    ros.wait(lambda: len(images) == 4, "four views")
    cell.stop()
    assert [i.header.stamp.sec for i in images] == [1, 2, 3, 4]
    ros.wait(lambda: "File too large" in ros.log("collector"), "a warning")
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, before)
    cell.start("after")
    cell.play(views=[0, 5, 6])
    cell.seen(2, "after")
    cell.stop()
    assert len(views_in(cell.file("scan_*_after.mcap"))) == 2
    assert ros.log("collector").count("recording stopped") == 1
    assert not list(cell.folder.glob("*_full*"))
