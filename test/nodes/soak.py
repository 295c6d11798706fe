# SPDX-License-Identifier: Apache-2.0
"""Many scans in a row, nodes ended in every state and killed at random; prints what it measured.

    make soak
    PYTHONPATH=test python test/nodes/soak.py --scans 10000 --plot memory.png --kills 200
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from geometry_msgs.msg import TransformStamped
from kits.harness import LATCHED, Harness
from rclpy.client import Client
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from stack_counter_msgs.msg import ScanStatus, StackCount
from stack_counter_msgs.srv import StartScan, StopScan
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from stack_counter.ros.standard_messages import to_camera_info, to_header, to_image, to_pose
from stack_counter.sim import read_scenes, record

SPACE = "/stack_counter"
NODES = ("collector", "reconstructor", "counter")
UNSEEN = Path(__file__).parents[2] / "data" / "unseen"
VIEWS, SCENE = 6, 11
STATES = ("idle", "scanning", "finishing")
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


class Station:
    """Three nodes and a camera that shows one scene again and again."""

    def __init__(self, folder: Path, estimator: str):
        self.ros = Harness(folder)
        scene = next(s for s in read_scenes(UNSEEN, SCENE + 1) if s.index == SCENE)
        random = np.random.default_rng(0)
        self.true, self.unit_volume = scene.truth.count, scene.truth.unit_volume
        self.views = [replace(v, color=random.integers(0, 255, (*v.depth.shape, 3), np.uint8))
                      for v in record(scene, VIEWS, color=False)]
        node, qos = self.ros.node, QoSProfile(depth=30)
        self.color = node.create_publisher(Image, "/camera/color/image_raw", qos)
        self.depth = node.create_publisher(
            Image, "/camera/aligned_depth_to_color/image_raw", qos)
        self.info = node.create_publisher(CameraInfo, "/camera/color/camera_info", qos)
        self.tf = node.create_publisher(TFMessage, "/tf", QoSProfile(depth=100))
        self.status: dict[str, ScanStatus] = {}
        node.create_subscription(ScanStatus, f"{SPACE}/scan_status",
                                 lambda m: self.status.__setitem__(m.node, m), 100)
        self.counts = self.ros.collect_messages(StackCount, f"{SPACE}/result", LATCHED)
        self.settings = {"counter": {"estimator": estimator}}
        self.processes = {name: self.ros.start(name, **self.settings.get(name, {}))
                          for name in NODES}
        self.clients: dict[str, Client] = {}
        self.scans, self.clock = 0, 0
        self.wait_for_collector()

    def wait_for_collector(self) -> None:
        """Waits until the collector receives the camera's topics."""
        self.ros.wait_until_collector_receives(self.color, self.depth, self.info, self.tf)

    def publish_view(self, view) -> None:
        """Publishes one view with its pose and calibration."""
        self.clock += 1
        header = to_header(self.clock * 10**9, view.camera)
        pose = to_pose(view.T_world_camera)
        for beside in (-10_000_000, 10_000_000):
            t = TransformStamped(header=to_header(self.clock * 10**9 + beside, "base_link"),
                                 child_frame_id=view.camera)
            for axis in "xyz":
                setattr(t.transform.translation, axis, getattr(pose.position, axis))
            t.transform.rotation = pose.orientation
            self.tf.publish(TFMessage(transforms=[t]))
        self.info.publish(to_camera_info(view.intrinsics, header))
        self.depth.publish(to_image(np.round(view.depth * 1000).astype(np.uint16), "16UC1",
                                    header))
        self.color.publish(to_image(view.color, "rgb8", header))

    def call(self, kind: type, name: str, request: object) -> Any:
        """Calls a service by one client for all scans: what nodes keep of each would add up."""
        client = self.clients.get(name) or self.ros.node.create_client(kind, name)
        self.clients[name] = client
        assert client.wait_for_service(30), f"no service {name}"
        future = client.call_async(request)
        self.ros.wait(future.done, f"an answer of {name}")
        return future.result()

    def start_scan(self) -> str:
        """Starts a scan and publishes all its views; returns its id."""
        self.scans += 1
        scan_id = f"scan{self.scans}"
        answer = self.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(
            scan_id=scan_id, unit_volume=self.unit_volume))
        assert answer.accepted, answer.message
        for view in self.views:
            self.publish_view(view)
        return scan_id

    def count_scan(self) -> tuple[StackCount, float]:
        """Runs one scan; returns its count and the seconds from the last image to it."""
        scan_id = self.start_scan()
        begin = time.monotonic()
        self.ros.wait(lambda: self.status["collector"].processed == VIEWS, "all views")
        self.call(StopScan, f"{SPACE}/stop_scan", StopScan.Request())
        self.ros.wait(lambda: self.counts and self.counts[-1].final
                      and self.counts[-1].scan_id == scan_id, f"the count of {scan_id}")
        taken = time.monotonic() - begin
        count = self.counts[-1]
        del self.counts[:-1]
        return count, taken

    def holds_truth(self, count: StackCount) -> bool:
        """Whether the interval holds the true count."""
        return count.count_low <= self.true <= count.count_high

    def spin(self, seconds: float) -> None:
        """Takes messages for a time."""
        end = time.monotonic() + seconds
        self.ros.wait(lambda: time.monotonic() > end, "the time to pass")

    def memory_mb(self) -> dict[str, float]:
        """Returns the resident memory of each node, MB."""
        pages = {name: int(Path(f"/proc/{p.pid}/statm").read_text().split()[1])
                 for name, p in self.processes.items()}
        return {name: n * 4096 / 1e6 for name, n in pages.items()}

    def cpu_s(self) -> dict[str, float]:
        """Returns the CPU time of each node, s."""
        fields = {name: Path(f"/proc/{p.pid}/stat").read_text().rsplit(")", 1)[1].split()
                  for name, p in self.processes.items()}
        return {name: (int(f[11]) + int(f[12])) / 100 for name, f in fields.items()}

    def signal_node(self, name: str, number: int) -> float:
        """Sends a signal to a node; returns the seconds until its process has ended."""
        process = self.processes[name]
        self.ros.processes.remove(process)
        begin = time.monotonic()
        process.send_signal(number)
        process.wait(30)
        return time.monotonic() - begin

    def restart_node(self, name: str) -> None:
        """Starts a node anew and has the others forget the scan, as a supervisor does."""
        self.processes[name] = self.ros.start(name, **self.settings.get(name, {}))
        self.clients.clear()
        # Once each, where the server is known: a second request, of a first that is answered
        # late, would make it forget the next scan.
        for server, service in (("reconstructor", "reset_reconstruction"), ("collector", "reset")):
            if server == name:
                self.ros.call_until_answered(Trigger, f"{SPACE}/{service}")
            else:
                self.ros.call(Trigger, f"{SPACE}/{service}", Trigger.Request())
        self.wait_for_collector()
        self.ros.wait(lambda: self.ros.node.count_subscribers(f"{SPACE}/volume") >= 1,
                      "a counter")


def repeat_scans(station: Station, scans: int, plot: Path | None) -> list[str]:
    """Repeats one scan; returns lines with counts, latency, memory and CPU, and plots memory."""
    answers, latencies, memory, cpu = set(), [], {}, {}
    curve = {0: station.memory_mb()}
    for i in range(1, scans + 1):
        count, taken = station.count_scan()
        assert not count.error, count.error
        answers.add(count.count)
        latencies.append(taken)
        if i in (min(20, scans // 2), scans):
            memory[i], cpu[i] = station.memory_mb(), (station.cpu_s(), time.monotonic())
        if i % 20 == 0:
            curve[i] = station.memory_mb()
            print(f"{i} scans, {curve[i]}", flush=True)
    if plot:
        plot_memory(curve, plot)
    (first, last), busy = memory.values(), list(cpu.values())
    span = busy[1][1] - busy[0][1]
    lines = [f"{scans} scans in a row of {VIEWS} views, 640x480: counts {sorted(answers)} (truth "
             f"{station.true})",
             f"last image to count: median {np.median(latencies):.2f} s, 95% "
             f"{np.quantile(latencies, 0.95):.2f} s, slowest {max(latencies):.2f} s"]
    lines += [f"{name:14} memory {first[name]:.0f} MB after {list(memory)[0]} scans, "
              f"{last[name]:.0f} MB after {scans} ({last[name] / first[name] - 1:+.1%}); CPU "
              f"{(busy[1][0][name] - busy[0][0][name]) / span:.0%} of a core"
              for name in NODES]
    return lines


def plot_memory(curve: dict[int, dict[str, float]], path: Path) -> None:
    """Draws the memory of each node, MB, over the number of scans."""
    matplotlib.use("Agg")
    from matplotlib import pyplot
    figure, axes = pyplot.subplots(figsize=(7, 3.5), layout="constrained")
    for name in NODES:
        axes.plot(list(curve), [memory[name] for memory in curve.values()], label=name)
    total = [sum(memory.values()) for memory in curve.values()]
    axes.plot(list(curve), total, "k--", label="all three")
    axes.set(xlabel=f"scans of {VIEWS} views", ylabel="resident memory, MB", ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)


def kill_at_random(station: Station, kills: int) -> list[str]:
    """Kills any node at any time of a scan, so many times, each time with a scan afterwards.

    Whatever count is said meanwhile must hold the truth. Returns a line.
    """
    random, said = np.random.default_rng(0), 0
    for i in range(kills):
        # Kill a node at some time of a scan.
        station.counts.clear()
        station.start_scan()
        if random.random() < 0.7:
            station.ros.wait(lambda: station.status["collector"].processed == VIEWS, "all views")
            station.ros.call(StopScan, f"{SPACE}/stop_scan", StopScan.Request())
        station.spin(random.uniform(0, 1.5))
        name = str(random.choice(NODES))
        station.signal_node(name, signal.SIGKILL)
        # Whatever is said of it, and the next scan, must be right.
        station.spin(0.2)
        station.restart_node(name)
        meant = list(station.counts)
        count, _ = station.count_scan()
        for message in (*meant, count):
            assert message.error or station.holds_truth(message), (i, name, message.count)
        assert not count.error, (i, name, count.error)
        said += sum(not message.error for message in meant)
        if i % 20 == 19:
            print(f"{i + 1} kills", flush=True)
    return [f"{kills} nodes killed at random: {said} counts before or after it and all {kills} "
            "of the next scans right"]


def end_nodes_in_every_state(station: Station) -> list[str]:
    """Ends every node in every state by every signal, each time with a scan afterwards.

    Returns lines with the seconds that the nodes needed to end.
    """
    lines = []
    for number in SIGNALS:
        for name in NODES:
            taken = []
            for state in STATES:
                if state != "idle":
                    station.start_scan()
                if state == "finishing":
                    station.ros.call(StopScan, f"{SPACE}/stop_scan", StopScan.Request())
                taken.append(station.signal_node(name, number))
                station.restart_node(name)
                count, _ = station.count_scan()
                assert not count.error, (name, state, count.error)
                assert station.holds_truth(count), (name, state, count.count)
            lines.append(f"{signal.Signals(number).name:8} {name:14} " + ", ".join(
                f"{state} {t:.2f} s" for state, t in zip(STATES, taken)) + "; next scan right")
            print(lines[-1], flush=True)
    return lines


def main() -> int:
    """Prints what was measured; an assertion fails where a count is not right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=200)
    parser.add_argument("--estimator", default="network")
    parser.add_argument("--plot", type=Path, metavar="PNG", help="memory over the scans")
    parser.add_argument("--kills", type=int, default=20, metavar="N", help="at random")
    parser.add_argument("--only", choices=("scans", "ends", "kills"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        station = Station(Path(folder), options.estimator)
        try:
            lines = []
            if options.only in (None, "scans"):
                lines += repeat_scans(station, options.scans, options.plot)
            if options.only in (None, "ends"):
                lines += end_nodes_in_every_state(station)
            if options.only in (None, "kills"):
                lines += kill_at_random(station, options.kills)
        finally:
            station.ros.close()
    print("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
