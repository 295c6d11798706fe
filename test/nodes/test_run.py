# SPDX-License-Identifier: Apache-2.0
"""`stack-counter run`: three nodes, one of which is killed in mid-scan."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from kits.harness import LATCHED, PATIENCE_S, Camera
from kits.result_schema import read_result
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from stack_counter_msgs.msg import ScanStatus, StackCount, StackVolume
from stack_counter_msgs.srv import StartScan
from std_msgs.msg import String
from std_srvs.srv import Trigger

from stack_counter.cli import main
from stack_counter.ros import supervisor

SPACE = "/stack_counter"


def children(process):
    """Process ids of the nodes, by name."""
    ids = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    lines = {int(i): Path(f"/proc/{i}/cmdline").read_text() for i in ids}
    return {name: i for i, line in lines.items()
            for name in ("collector", "reconstructor", "counter") if f"nodes\0{name}\0" in line}


def test_a_node_that_is_killed_comes_back_and_its_scan_is_reported_lost(ros, tmp_path):
    settings = tmp_path / "p.yaml"
    settings.write_text(
        '/stack_counter/collector: {ros__parameters: {depth_topic: ""}}\n'
        "/stack_counter/counter: {ros__parameters: {estimator: prior, result_json: true}}\n")
    log = open(tmp_path / "run.log", "w")
    run = subprocess.Popen([sys.executable, "-m", "stack_counter", "run", "--config",
                            str(settings)], stdout=log, stderr=subprocess.STDOUT,
                           env={**os.environ, **ros.environment})
    ros.processes.append(run)
    counts = ros.collect_messages(StackCount, f"{SPACE}/result", LATCHED)
    texts = ros.collect_messages(String, f"{SPACE}/result_json", LATCHED)
    states = ros.collect_messages(ScanStatus, f"{SPACE}/scan_status")
    diagnostics = ros.collect_messages(DiagnosticArray, "/diagnostics")

    def reconstructor_is_ready():
        return any(s.node == "reconstructor" for s in states)
    camera = Camera(ros)
    ros.wait(reconstructor_is_ready, "the reconstructor")
    assert ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(
        scan_id="doomed", part="cube", unit_volume=1e-6)).accepted
    camera(0)
    ros.wait(lambda: any(s.scan_id == "doomed" and s.received for s in states), "a view")
    before = children(run)
    os.kill(before["reconstructor"], signal.SIGKILL)
    ros.wait(lambda: counts and counts[-1].scan_id == "doomed" and counts[-1].final,
             "word of the lost scan")
    assert counts[-1].status == StackCount.STATUS_ERROR and counts[-1].final
    assert counts[-1].error == "scan 'doomed' lost: reconstructor ended with signal 9"
    assert (counts[-1].part, counts[-1].unit_volume) == ("cube", 1e-6)
    ros.wait(lambda: any(s.level == DiagnosticStatus.ERROR and "signal 9" in s.message
                         for m in diagnostics for s in m.status), "an error in the diagnostics")
    states.clear()
    ros.wait(reconstructor_is_ready, "the reconstructor again")
    after = children(run)
    assert after["reconstructor"] != before["reconstructor"]
    assert after["collector"] == before["collector"]
    ros.wait(lambda: ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(
        scan_id="next")).accepted, "the next scan")
    # Without a counter the supervisor itself says what is lost, to latecomers too.
    ros.wait(lambda: any(s.scan_id == "next" for s in states), "word of the scan")
    os.kill(after["counter"], signal.SIGKILL)
    ros.wait(lambda: counts[-1].scan_id == "next", "word of the second lost scan")
    assert counts[-1].error == "scan 'next' lost: counter ended with signal 9"
    late = ros.collect_messages(StackCount, f"{SPACE}/result", QoSProfile(
        depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    ros.wait(lambda: late, "the latched error")
    assert late[0].scan_id == "next"
    ros.wait(lambda: texts and '"next"' in texts[-1].data, "the same as JSON")
    assert read_result(texts[-1].data, "flat")["error"] == counts[-1].error
    ros.processes.remove(run)
    run.send_signal(signal.SIGTERM)
    assert run.wait(PATIENCE_S) == 0
    assert not any(Path(f"/proc/{i}").exists() for i in after.values())
    assert [message.scan_id for message in late] == ["next"]
    log.close()
    text = (tmp_path / "run.log").read_text()
    assert "scan 'doomed' lost" in text and "Traceback" not in text


class DiesAtOnce:
    """Stands in for the process of the reconstructor, which has ended; the others run."""

    def __init__(self, name, parameters, ros_arguments):
        self.name, self.restarts, self.restart_at, self.running = name, 0, 0.0, True
        self._cause = "signal 9" if name == "reconstructor" else ""

    def take_death(self):
        cause, self._cause = self._cause, ""
        return cause

    def restart_if_due(self):
        pass

    @staticmethod
    def stop_all(processes):
        pass


def test_a_scan_of_which_the_supervisor_hears_after_a_death_is_lost_as_well(
        ros, tmp_path, monkeypatch):
    """The supervisor's timer comes before any message of the nodes; resets wait for the nodes."""
    monkeypatch.setattr(supervisor, "SupervisedProcess", DiesAtOnce)
    monkeypatch.setattr(supervisor, "SETTINGS", replace(supervisor.SETTINGS, watch_period_s=0.0))
    volumes = ros.collect_messages(StackVolume, f"{SPACE}/volume")
    status = ros.node.create_publisher(ScanStatus, f"{SPACE}/scan_status", LATCHED)
    status.publish(ScanStatus(node="collector", state=ScanStatus.SCANNING, scan_id="early"))
    settings, resets = tmp_path / "p.yaml", []
    settings.write_text("{}")
    rclpy.init(domain_id=int(ros.environment["ROS_DOMAIN_ID"]))
    node = supervisor.Supervisor(settings)
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin_until(condition, what):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, what
            executor.spin_once(0.05)
    try:
        spin_until(lambda: volumes, "word of the lost scan")

        def reset(request, response):
            resets.append(request)
            return response
        ros.node.create_service(Trigger, f"{SPACE}/reset", reset)
        spin_until(lambda: resets, "a reset of the collector")
        ros.wait(lambda: len(volumes) == 1, "one volume")
    finally:
        node.destroy_node()
        rclpy.shutdown()
    assert volumes[0].error == "scan 'early' lost: reconstructor ended with signal 9"
    assert volumes[0].scan_id == "early" and volumes[0].final


def test_bad_settings_are_one_line_and_start_nothing(tmp_path, capsys):
    path = tmp_path / "p.yaml"
    path.write_text("/stack_counter/counter: {ros__parameters: {confidence: 7.0}}\n")
    assert main(["run", "--config", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["run", "--config", str(tmp_path / "none.yaml")]) == 2
