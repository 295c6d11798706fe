# SPDX-License-Identifier: Apache-2.0
"""Real DDS on a domain of its own: a test node that spins in the background, and processes."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from stack_counter_msgs.msg import ScanStatus
from stack_counter_msgs.srv import StartScan
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from stack_counter.ros.private_domain import PrivateDomain
from stack_counter.ros.standard_messages import to_camera_info, to_header, to_image
from stack_counter.types import Intrinsics

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PATIENCE_S = 120.0
FRAME = "camera_color_optical_frame"


class Harness:
    """A node named `test`, its context, and the processes started for it."""

    def __init__(self, folder):
        self.folder = folder
        self._domain = PrivateDomain()
        self.environment = self._domain.environment
        os.environ.update(self.environment)
        self.context = rclpy.context.Context()
        rclpy.init(context=self.context, domain_id=self._domain.number)
        self.node = rclpy.create_node("test", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._spinner = threading.Thread(target=self._spin, daemon=True)
        self._spinner.start()
        self.processes = []

    def _spin(self):
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass

    def spin_too(self, node):
        """Has the thread in the background spin another node of this context."""
        self._executor.add_node(node)

    def start(self, name, **parameters):
        """Starts one node as a process with these parameters; returns the process."""
        arguments = [x for key, value in parameters.items() for x in ("-p", f"{key}:={value}")]
        log = open(self.folder / f"{name}.log", "wb")
        process = subprocess.Popen(
            [sys.executable, "-m", f"stack_counter.nodes.{name}", "--ros-args", *arguments],
            env={**os.environ, **self.environment}, stdout=log, stderr=subprocess.STDOUT)
        log.close()
        self.processes.append(process)
        return process

    def log(self, name):
        """Returns what a node has printed."""
        return (self.folder / f"{name}.log").read_text()

    def collect_messages(self, kind, topic, qos=QoSProfile(depth=300)):
        """Returns a list to which the messages of a topic are appended as they come."""
        messages = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def call(self, kind, name, request):
        """Calls a service and returns its answer."""
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(PATIENCE_S), f"no service {name}"
        future = client.call_async(request)
        self.wait(future.done, f"an answer of {name}")
        return future.result()

    def call_until_answered(self, kind, name):
        """Calls a service without arguments until it answers; returns the answer.

        A request to a server that is just being matched can get lost.
        """
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(PATIENCE_S), f"no service {name}"
        for _ in range(20):
            future = client.call_async(kind.Request())
            deadline = time.monotonic() + 3
            while not future.done() and time.monotonic() < deadline:
                threading.Event().wait(0.01)
            if future.done():
                return future.result()
        raise AssertionError(f"no answer of {name}")

    def call_in_executor(self, call):
        """Makes a call in the thread that spins and returns what it gives.

        An action's answer can come before the call that asked for it has returned; it is then
        dropped. In the thread that takes answers it cannot.
        """
        task = self._executor.create_task(call)
        self.wait(task.done, "a call")
        return task.result()

    def wait(self, condition, what, seconds=PATIENCE_S):
        """Waits until the condition holds; fails the test where it does not in time."""
        deadline = time.monotonic() + seconds
        pause = threading.Event()
        while not condition():
            assert time.monotonic() < deadline, f"waited {seconds} s for {what}"
            for process in self.processes:
                assert process.poll() is None, f"a node ended while waiting for {what}"
            pause.wait(0.01)

    def wait_for_subscribers(self, *publishers):
        """Waits until every publisher has a subscriber."""
        self.wait(lambda: all(p.get_subscription_count() for p in publishers), "subscribers")

    def wait_until_collector_receives(self, *publishers):
        """Waits until the collector itself reports that it receives from these publishers."""
        topics = {p.topic_name for p in publishers}

        def receives():
            answer = self.call(StartScan, "/stack_counter/start_scan", StartScan.Request())
            self.call(Trigger, "/stack_counter/reset", Trigger.Request())
            return answer.accepted and not topics & set(answer.unmatched_topics)

        self.wait_for_subscribers(*publishers)
        self.wait(receives, f"the collector to receive {sorted(topics)}")

    def close(self):
        """Stops everything."""
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.wait(PATIENCE_S)
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)
        self._spinner.join()
        self._domain.close()


class Camera:
    """A colour camera on the default topics, with TF."""

    def __init__(self, ros, intrinsics=Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5),
                 qos=QoSProfile(depth=30), wait_for_collector=True):
        self.k = intrinsics
        self.color = ros.node.create_publisher(Image, "/camera/color/image_raw", qos)
        self.info = ros.node.create_publisher(CameraInfo, "/camera/color/camera_info", qos)
        self.tf = ros.node.create_publisher(TFMessage, "/tf", QoSProfile(depth=1000))
        self._pictures = {}
        if wait_for_collector:
            ros.wait_until_collector_receives(self.color, self.info, self.tf)

    def picture(self, k):
        """Returns a sharp picture of the size of a calibration."""
        if k not in self._pictures:
            self._pictures[k] = np.random.default_rng(0).integers(
                0, 255, (k.height, k.width, 3), np.uint8)
        return self._pictures[k]

    def publish_pose(self, i, beside_ns=0):
        """Publishes TF of view number i, `beside_ns` from its stamp."""
        t = TransformStamped(header=to_header((i + 1) * 10**9 + beside_ns, "base_link"),
                             child_frame_id=FRAME)
        t.transform.translation.x = 0.01 * i
        self.tf.publish(TFMessage(transforms=[t]))

    def __call__(self, i, with_tf=True, k=None, image=None):
        """Publishes view number i, taken at i + 1 s."""
        k = k or self.k
        header = to_header((i + 1) * 10**9, FRAME)
        if with_tf:
            self.publish_pose(i, -20_000_000)
            self.publish_pose(i, 20_000_000)
        self.info.publish(to_camera_info(k, header))
        self.color.publish(image or to_image(self.picture(k), "rgb8", header))


class StandInReconstructor:
    """Subscribes to posed images and publishes their reception, as the reconstructor does.

    It says that it is there once so many subscribe to its status; it is itself one of them.
    """

    def __init__(self, ros, subscribers=1):
        from stack_counter_msgs.msg import PosedImage

        self.images = []
        self._status = ros.node.create_publisher(ScanStatus, "/stack_counter/scan_status",
                                                 QoSProfile(depth=100))
        ros.node.create_subscription(PosedImage, "/stack_counter/posed_images", self._on_image,
                                     QoSProfile(depth=100))
        ros.node.create_subscription(ScanStatus, "/stack_counter/scan_status", self._on_status,
                                     QoSProfile(depth=100))
        ros.wait(lambda: self._status.get_subscription_count() >= subscribers, "subscribers")
        self._status.publish(ScanStatus(node="reconstructor"))

    def _publish_status(self, scan_id, state=ScanStatus.SCANNING):
        received = sum(m.scan_id == scan_id for m in self.images)
        self._status.publish(ScanStatus(node="reconstructor", scan_id=scan_id, state=state,
                                        received=received))

    def _on_image(self, message):
        self.images.append(message)
        self._publish_status(message.scan_id)

    def _on_status(self, message):
        if message.node == "collector" and message.state == ScanStatus.STOPPED:
            self._publish_status(message.scan_id, ScanStatus.STOPPED)
