"""The action `count_stack`, and the same through services: start a scan, wait for its views, stop
it, answer with the count and its verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from stack_counter_msgs.action import CountStack
from stack_counter_msgs.msg import ScanStatus, StackCount
from stack_counter_msgs.srv import GetCount, StartCount, StartScan, StopScan
from std_srvs.srv import Trigger

from stack_counter.config import CounterConfig
from stack_counter.errors import ConfigError, PartError
from stack_counter.parts.catalogue import resolve_part
from stack_counter.ros.conversions import set_verdict
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.qos import RELIABLE

_COLLECTOR_WITHIN_S = 5.0  # a collector that is just starting is waited for
_ANSWER_WITHIN_S = 10.0  # of a service
_COUNT_WITHIN_S = 20.0  # from the end of the scan to the count


class Job:
    """One count that is running: what was asked, and what has come so far."""

    def __init__(self, request: Any, tell: Callable[[CountStack.Feedback], None]):
        self.request, self.tell = request, tell
        self.scan_id: str | None = None  # None: not started; empty: the next scan, whatever its id
        self.enough, self.counted = Future(), Future()
        self.feedback = CountStack.Feedback()
        self.running = StackCount()

    def end(self, why: str) -> None:
        """The scan ends, if it has not."""
        if not self.enough.done():
            self.enough.set_result(why)


class CountAction:
    """One job at a time; every wait is a future that a callback or a timer completes."""

    def __init__(self, node: ManagedNode, config: CounterConfig):
        self._node, self.config = node, config
        self._job: Job | None = None
        self._last = GetCount.Response(message="nothing was counted yet")
        self.rejected = ""  # why the last request was
        group = ReentrantCallbackGroup()
        self._start = node.create_client(StartScan, "start_scan", callback_group=group)
        self._stop = node.create_client(StopScan, "stop_scan", callback_group=group)
        self._made = [
            (node.destroy_subscription, node.create_subscription(
                ScanStatus, "scan_status", self._on_status, RELIABLE, callback_group=group)),
            (node.destroy_service, node.create_service(
                StartCount, "start_count", self._start_count, callback_group=group)),
            (node.destroy_service, node.create_service(
                GetCount, "get_count", self._get_count, callback_group=group)),
            (node.destroy_service, node.create_service(
                Trigger, "cancel_count", self._cancel_count, callback_group=group)),
            (node.destroy_client, self._start), (node.destroy_client, self._stop)]
        self._server = ActionServer(
            node, CountStack, "count_stack", self._execute, callback_group=group,
            goal_callback=self._on_goal, cancel_callback=self._on_cancel)

    def destroy(self) -> None:
        """Gives back what the node lent; a job that runs ends."""
        if self._job is not None:
            self._job.end("cancelled")
        self._server.destroy()
        for destroy, made in self._made:
            destroy(made)

    @property
    def busy(self) -> bool:
        """Whether a count is running."""
        return self._job is not None

    def confidence_of(self, scan_id: str) -> float:
        """What a scan's interval shall hold the truth with: as its job asks, else the setting."""
        job = self._job
        mine = job is not None and job.scan_id in ("", scan_id)
        return (job.request.confidence if mine and job is not None else 0.0) \
            or self.config.confidence

    def on_count(self, count: StackCount) -> None:
        """The counter has counted; a job's scan is answered by its own count."""
        job = self._job
        if job is None or job.scan_id is None or (job.scan_id and count.scan_id != job.scan_id):
            return
        if count.final:
            if not job.counted.done():
                job.counted.set_result(count)
                job.end("scan ended")
        elif not count.error:
            job.running = count
            f = job.feedback
            f.count, f.count_low, f.count_high = count.count, count.count_low, count.count_high
            f.stack_volume = count.stack_volume
            job.tell(f)

    def _on_status(self, status: ScanStatus) -> None:
        """Feedback, and the end of the scan once enough views are in."""
        job = self._job
        if job is None or not job.scan_id or status.scan_id != job.scan_id \
                or status.node != "reconstructor":
            return
        f = job.feedback
        f.coverage, f.stack_volume = status.coverage, status.stack_volume
        f.views.received, f.views.used = status.received, status.processed
        f.views.skip_reasons, f.views.skip_counts = status.skip_reasons, status.skip_counts
        job.tell(f)
        if job.request.max_views and status.processed >= job.request.max_views:
            job.end("views")

    # --- asked by action ----------------------------------------------------------------------

    def _on_goal(self, goal: CountStack.Goal) -> GoalResponse:
        self.rejected = self._objection(goal)
        if self.rejected:
            self._node.get_logger().warning(f"goal rejected: {self.rejected}")
            return GoalResponse.REJECT
        self._job = Job(goal, lambda feedback: None)
        return GoalResponse.ACCEPT

    def _objection(self, asked: Any) -> str:
        """Why it cannot be counted now; empty if it can."""
        if not self._node.active:
            return "the counter is not active; expected an active node"
        if self.busy:
            return "another count is running; expected one at a time"
        if not (math.isfinite(asked.timeout) and asked.timeout >= 0 and 0 <= asked.confidence < 1):
            return (f"timeout {asked.timeout} s, confidence {asked.confidence}; expected 0 or "
                    "more, and 0 to 1")
        if asked.max_views and asked.max_views < asked.min_views:
            return (f"{asked.min_views} to {asked.max_views} views; expected a maximum of 0 "
                    "(none) or at least the minimum")
        try:
            named = (asked.part, asked.unit_volume) if asked.part or asked.unit_volume \
                else (self.config.part, self.config.unit_volume_m3)
            resolve_part(*named, self.config.part_catalogue)
        except (PartError, ConfigError) as error:
            return str(error)
        return ""

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if self._job is not None:
            self._job.end("cancelled")
        return CancelResponse.ACCEPT

    async def _execute(self, goal: ServerGoalHandle) -> CountStack.Result:
        job = self._job
        assert job is not None  # for the type checker: made when the goal was accepted
        job.tell = lambda feedback: goal.publish_feedback(feedback) if goal.is_active else None
        answer = await self._answered(job)
        if answer.success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return CountStack.Result(count=answer.count, success=answer.success,
                                 message=answer.message)

    # --- asked by service ---------------------------------------------------------------------

    def _start_count(self, request: StartCount.Request, response: StartCount.Response
                     ) -> StartCount.Response:
        self.rejected = response.message = self._objection(request)
        response.accepted = not self.rejected
        if response.accepted:
            self._job = Job(request, lambda feedback: None)
            self._node.executor.create_task(self._answered(self._job))
        return response

    def _get_count(self, request: GetCount.Request, response: GetCount.Response
                   ) -> GetCount.Response:
        job = self._job
        if job is None:
            return self._last
        response.running, response.count = True, job.running
        response.message = f"{job.feedback.views.used} views used"
        return response

    def _cancel_count(self, request: Trigger.Request, response: Trigger.Response
                      ) -> Trigger.Response:
        response.success = self._job is not None
        response.message = "" if self._job is not None else "nothing is counted; expected a count"
        if self._job is not None:
            self._job.end("cancelled")
        return response

    # --- the count ----------------------------------------------------------------------------

    async def _answered(self, job: Job) -> GetCount.Response:
        """The job's answer; then the next one can come."""
        answer = GetCount.Response()
        try:
            count, answer.message = await self._counted(job)
            if count is not None:
                answer.count, answer.success = count, True
            else:
                self._node.get_logger().error(f"count_stack: {answer.message}")
            return answer
        finally:
            self._job, self._last = None, answer

    async def _counted(self, job: Job) -> tuple[StackCount | None, str]:
        """The count, or None; and a line that says how it ended."""
        asked = job.request
        for _ in range(round(_COLLECTOR_WITHIN_S / 0.1)):
            if self._start.service_is_ready() or job.enough.done():
                break
            await self._within(Future(), 0.1, None)
        if job.enough.done():
            return None, job.enough.result()
        if not self._start.service_is_ready():
            return None, "no collector offers start_scan; expected one running"
        started = await self._within(self._start.call_async(StartScan.Request(
            part=asked.part, unit_volume=asked.unit_volume)), _ANSWER_WITHIN_S, None)
        if started is None or not started.accepted:
            return None, started.message if started else "start_scan gave no answer"
        job.scan_id = started.scan_id
        ended = await self._within(job.enough, asked.timeout or self.config.timeout_s, "timeout")
        if not job.counted.done() and started.scan_id:
            await self._within(self._stop.call_async(StopScan.Request()), _ANSWER_WITHIN_S, None)
        if ended == "cancelled":
            return None, "cancelled"
        count = await self._within(job.counted, _COUNT_WITHIN_S, None)
        if count is None:
            return None, f"no count within {_COUNT_WITHIN_S} s of the scan's end ({ended})"
        if count.error:
            return None, count.error
        if count.views.used < asked.min_views:
            return None, f"{count.views.used} views used; expected at least {asked.min_views}"
        why = set_verdict(count, asked.expected_count, asked.tolerance)
        return count, f"{why}; ended by {ended}"

    async def _within(self, future: Future, seconds: float, otherwise: Any) -> Any:
        """The future's result, or `otherwise` after that time."""
        timed = Future()
        timer = self._node.create_timer(
            seconds, lambda: None if timed.done() else timed.set_result(otherwise),
            callback_group=ReentrantCallbackGroup(), clock=self._node.steady)
        future.add_done_callback(
            lambda f: None if timed.done() else timed.set_result(f.result()))
        try:
            return await timed
        finally:
            self._node.destroy_timer(timer)
