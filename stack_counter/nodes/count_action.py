"""The action `count_stack`: start a scan, wait for its views, stop it, answer with the count."""

from __future__ import annotations

from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNode
from rclpy.task import Future
from stack_counter_msgs.action import CountStack
from stack_counter_msgs.msg import ScanStatus, StackCount
from stack_counter_msgs.srv import StartScan, StopScan

from stack_counter.counting import verdict
from stack_counter.nodes.base import RELIABLE

_COLLECTOR_WITHIN_S = 5.0  # a collector that is just starting is waited for
_COUNT_WITHIN_S = 20.0  # from the end of the scan to the count
_VERDICTS = {"none": StackCount.VERDICT_NONE, "pass": StackCount.VERDICT_PASS,
             "fail": StackCount.VERDICT_FAIL, "unsure": StackCount.VERDICT_UNSURE}


class CountAction:
    """One goal at a time; every wait is a future that a callback or a timer completes."""

    def __init__(self, node: LifecycleNode, confidence: float):
        self._node = node
        self._default_confidence = self.confidence = confidence
        self._goal: ServerGoalHandle | None = None
        self._busy = False
        self._scan_id = ""
        self._enough = self._counted = Future()
        group = ReentrantCallbackGroup()
        self._start = node.create_client(StartScan, "start_scan", callback_group=group)
        self._stop = node.create_client(StopScan, "stop_scan", callback_group=group)
        self._statuses = node.create_subscription(ScanStatus, "scan_status", self._on_status,
                                                  RELIABLE, callback_group=group)
        self._server = ActionServer(
            node, CountStack, "count_stack", self._execute, callback_group=group,
            goal_callback=self._on_goal, cancel_callback=self._on_cancel)

    def destroy(self) -> None:
        """Gives back what the node lent."""
        self._server.destroy()
        self._node.destroy_subscription(self._statuses)
        self._node.destroy_client(self._start)
        self._node.destroy_client(self._stop)

    def on_count(self, count: StackCount) -> None:
        """The counter has counted; the goal's scan is answered by its own count."""
        if self._busy and count.scan_id == self._scan_id and not self._counted.done() \
                and self._enough.done():
            self._counted.set_result(count)

    def _on_goal(self, goal: CountStack.Goal) -> GoalResponse:
        if self._busy or goal.timeout <= 0 or not 0 <= goal.confidence < 1 \
                or (goal.max_views and goal.max_views < goal.min_views):
            self._node.get_logger().warning(
                "goal rejected: another is running" if self._busy else
                f"goal rejected: timeout {goal.timeout}, confidence {goal.confidence}, views "
                f"{goal.min_views} to {goal.max_views}; expected above 0, 0 to 1, and min <= max")
            return GoalResponse.REJECT
        self._busy = True
        return GoalResponse.ACCEPT

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if not self._enough.done():
            self._enough.set_result("cancelled")
        return CancelResponse.ACCEPT

    def _on_status(self, status: ScanStatus) -> None:
        """Feedback, and the end of the scan once enough views are in."""
        if self._goal is None or status.scan_id != self._scan_id \
                or status.node != "reconstructor":
            return
        feedback = CountStack.Feedback(coverage=status.coverage, stack_volume=status.stack_volume)
        feedback.views.received, feedback.views.used = status.received, status.processed
        feedback.views.skip_reasons = status.skip_reasons
        feedback.views.skip_counts = status.skip_counts
        if self._goal.is_active:
            self._goal.publish_feedback(feedback)
        most = self._goal.request.max_views
        if most and status.processed >= most and not self._enough.done():
            self._enough.set_result("views")

    async def _execute(self, goal: ServerGoalHandle) -> CountStack.Result:
        request = goal.request
        self._goal, self._enough, self._counted = goal, Future(), Future()
        self.confidence = request.confidence or self._default_confidence
        try:
            return await self._scan(goal, request)
        finally:
            self._goal, self._busy, self.confidence = None, False, self._default_confidence

    async def _scan(self, goal: ServerGoalHandle, request: CountStack.Goal) -> CountStack.Result:
        for _ in range(round(_COLLECTOR_WITHIN_S / 0.1)):
            if self._start.service_is_ready():
                break
            await self._within(Future(), 0.1, None)
        else:
            return self._failed(goal, "no collector offers start_scan; expected one running")
        started = await self._start.call_async(
            StartScan.Request(part=request.part, unit_volume=request.unit_volume))
        if not started.accepted:
            return self._failed(goal, started.message)
        self._scan_id = started.scan_id
        ended = await self._within(self._enough, request.timeout, "timeout")
        await self._stop.call_async(StopScan.Request())
        if ended == "cancelled":
            goal.canceled()
            return CountStack.Result(message="cancelled")
        count = await self._within(self._counted, _COUNT_WITHIN_S, None)
        if count is None:
            return self._failed(goal, f"no count within {_COUNT_WITHIN_S} s of the scan's end")
        if count.error:
            return self._failed(goal, count.error)
        if count.views.used < request.min_views:
            return self._failed(goal, f"{count.views.used} views used; expected at least "
                                      f"{request.min_views}")
        count.verdict = _VERDICTS[verdict((count.count_low, count.count_high),
                                          request.expected_count, request.tolerance)]
        goal.succeed()
        return CountStack.Result(count=count, success=True, message=f"ended by {ended}")

    async def _within(self, future: Future, seconds: float, otherwise: Any) -> Any:
        """The future's result, or `otherwise` after that time."""
        timer = self._node.create_timer(
            seconds, lambda: None if future.done() else future.set_result(otherwise),
            callback_group=ReentrantCallbackGroup())
        try:
            return await future
        finally:
            self._node.destroy_timer(timer)

    def _failed(self, goal: ServerGoalHandle, message: str) -> CountStack.Result:
        self._node.get_logger().error(f"count_stack: {message}")
        goal.abort()
        return CountStack.Result(message=message)
