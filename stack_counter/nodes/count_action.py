# SPDX-License-Identifier: Apache-2.0
"""A count on request: the action `count_stack`, and services that offer the same."""

from __future__ import annotations

import math

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from stack_counter_msgs.action import CountStack
from stack_counter_msgs.msg import ScanStatus, StackCount
from stack_counter_msgs.srv import GetCount, StartCount
from std_srvs.srv import Trigger

from stack_counter.config import CounterConfig
from stack_counter.errors import ConfigError, PartError
from stack_counter.nodes.count_job import CountJob, CountJobRunner, Request
from stack_counter.parts.part_lookup import check_names_a_part, configured_part, resolve_part
from stack_counter.ros.bad_requests import check_names, guarded
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.part_fields import from_part_fields
from stack_counter.ros.qos import RELIABLE
from stack_counter.types import PartRequest


class CountAction:
    """Takes requests and answers them, one at a time."""

    def __init__(self, node: ManagedNode, config: CounterConfig):
        """Offers the action and the services of a node that is being set up."""
        self._node, self.config = node, config
        self._job: CountJob | None = None
        self._cancelled_scan: str | None = None  # of the last job, if it was cancelled
        self._last = GetCount.Response(message="nothing was counted yet")
        self.rejected = ""  # why the last request was rejected
        group = ReentrantCallbackGroup()
        self._runner = CountJobRunner(node, group)
        self._subscription = node.create_subscription(
            ScanStatus, "scan_status", self._on_status, RELIABLE, callback_group=group)
        self._services = [
            node.create_service(kind, name, guarded(kind, callback, node.get_logger()),
                                callback_group=group)
            for kind, name, callback in (
                (StartCount, "start_count", self._on_start_count),
                (GetCount, "get_count", self._on_get_count),
                (Trigger, "cancel_count", self._on_cancel_count))]
        self._server = ActionServer(
            node, CountStack, "count_stack", self._execute, callback_group=group,
            goal_callback=self._on_goal, cancel_callback=self._on_cancel)

    def destroy(self) -> None:
        """Withdraws the action and the services; a job that runs is cancelled."""
        if self._job is not None:
            self._job.finish("cancelled")
        self._server.destroy()
        self._node.destroy_subscription(self._subscription)
        for service in self._services:
            self._node.destroy_service(service)
        self._runner.destroy()

    @property
    def is_busy(self) -> bool:
        """Whether a count is running."""
        return self._job is not None

    def requested_confidence(self, scan_id: str) -> float:
        """Returns the confidence that a scan's interval needs: its job's, else the setting."""
        request = self._request_of(scan_id)
        return request.confidence if request and request.confidence else self.config.confidence

    def requested_part(self, scan_id: str) -> PartRequest:
        """Returns the part of a scan that names none: its job's, or the node's.

        A scan without any view cannot name its part.
        """
        request = self._request_of(scan_id)
        return self._part_of(request) if request else configured_part(self.config)

    def _part_of(self, request: Request) -> PartRequest:
        """Returns the part that a request names, or the node's own."""
        part = from_part_fields(request)
        return part if part.names_a_part else configured_part(self.config)

    def _request_of(self, scan_id: str) -> Request | None:
        """Returns what was asked for by the job of a scan; None if no job has it."""
        return self._job.request if self._job and self._job.scan_id in ("", scan_id) else None

    def is_cancelled(self, scan_id: str) -> bool:
        """Whether a scan is that of the job that was cancelled last."""
        job_scan = self._job.scan_id if self._job and self._job.is_cancelled \
            else self._cancelled_scan
        return bool(scan_id) and job_scan == scan_id

    def on_count(self, count: StackCount) -> None:
        """Passes what the counter has counted to the job that runs."""
        if self._job is not None:
            self._job.on_count(count)

    def _on_status(self, status: ScanStatus) -> None:
        if self._job is not None:
            self._job.on_status(status)

    # --- requests by action -------------------------------------------------------------------

    def _on_goal(self, goal: CountStack.Goal) -> GoalResponse:
        self.rejected = self._rejection_reason(goal)
        if self.rejected:
            self._node.get_logger().warning(f"goal rejected: {self.rejected}")
            return GoalResponse.REJECT
        self._job = CountJob(goal)
        return GoalResponse.ACCEPT

    def _rejection_reason(self, request: Request) -> str:
        """Returns why a request cannot be counted now; "" if it can."""
        if not self._node.active:
            return "the counter is not active; expected an active node"
        if self.is_busy:
            return "another count is running; expected one at a time"
        if not (math.isfinite(request.timeout) and request.timeout >= 0
                and 0 <= request.confidence < 1):
            return (f"timeout {request.timeout} s, confidence {request.confidence}; expected 0 or "
                    "more, and 0 to 1")
        if request.max_views and request.max_views < request.min_views:
            return (f"{request.min_views} to {request.max_views} views; expected a maximum of 0 "
                    "(none) or at least the minimum")
        try:
            check_names(part=request.part)
            check_names_a_part(from_part_fields(request))
            resolve_part(self._part_of(request), self.config.part_catalogue)
        except (PartError, ConfigError) as error:
            return str(error)
        return ""

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if self._job is not None:
            self._job.finish("cancelled")
        return CancelResponse.ACCEPT

    async def _execute(self, goal: ServerGoalHandle) -> CountStack.Result:
        job = self._job
        assert job is not None  # for the type checker: made when the goal was accepted
        job.publish_feedback = \
            lambda feedback: goal.publish_feedback(feedback) if goal.is_active else None
        answer = await self._run_job(job)
        if answer.success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return CountStack.Result(count=answer.count, success=answer.success,
                                 message=answer.message)

    # --- requests by service ------------------------------------------------------------------

    def _on_start_count(self, request: StartCount.Request, response: StartCount.Response
                        ) -> StartCount.Response:
        self.rejected = response.message = self._rejection_reason(request)
        response.accepted = not self.rejected
        if response.accepted:
            self._job = CountJob(request)
            assert self._node.executor is not None  # for the type checker: it has called this
            self._node.executor.create_task(self._run_job(self._job))
        return response

    def _on_get_count(self, request: GetCount.Request, response: GetCount.Response
                      ) -> GetCount.Response:
        job = self._job
        if job is None:
            return self._last
        response.running, response.count = True, job.running_count
        response.message = f"{job.feedback.views.used} views used"
        return response

    def _on_cancel_count(self, request: Trigger.Request, response: Trigger.Response
                         ) -> Trigger.Response:
        response.success = self._job is not None
        response.message = "" if self._job is not None else "nothing is counted; expected a count"
        if self._job is not None:
            self._job.finish("cancelled")
        return response

    # --- the job ------------------------------------------------------------------------------

    async def _run_job(self, job: CountJob) -> GetCount.Response:
        """Runs a job to its end and returns its answer; then another job can start."""
        answer = GetCount.Response()
        try:
            outcome = await self._runner.run(job, job.request.timeout or self.config.timeout_s)
            answer.message = outcome.message
            if outcome.count is not None:
                answer.count, answer.success = outcome.count, True
            elif job.is_cancelled:
                self._node.get_logger().info(f"count_stack: scan '{job.scan_id or ''}' cancelled")
            else:
                self._node.get_logger().error(f"count_stack: {answer.message}")
            return answer
        finally:
            self._cancelled_scan = job.scan_id if job.is_cancelled else None
            self._job, self._last = None, answer
