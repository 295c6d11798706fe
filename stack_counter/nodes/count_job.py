# SPDX-License-Identifier: Apache-2.0
"""One count on request: start a scan, wait for its views, stop it, wait for its count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup
from rclpy.task import Future
from stack_counter_msgs.action import CountStack
from stack_counter_msgs.msg import ScanStatus, StackCount
from stack_counter_msgs.srv import StartCount, StartScan, StopScan

from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.part_fields import from_part_fields, to_part_fields
from stack_counter.ros.verdicts import set_verdict

Request: TypeAlias = "CountStack.Goal | StartCount.Request"  # they have the same fields


@dataclass(frozen=True)
class CountTimeouts:
    """How long a count waits for other nodes; all are chosen.

    Attributes:
        collector_s: seconds that a collector which is just starting is waited for.
        collector_poll_s: seconds between two looks whether it has started.
        answer_s: seconds for a service's answer.
        count_s: seconds from the end of the scan to the count.
    """

    collector_s: float = 5.0
    collector_poll_s: float = 0.1
    answer_s: float = 10.0
    count_s: float = 20.0


TIMEOUTS = CountTimeouts()


@dataclass(eq=False)
class CountJob:
    """One count that is running.

    Attributes:
        request: what is to be counted.
        publish_feedback: called whenever `feedback` has changed.
        hint: what the collector has said when the scan was started, e.g. of wrong topics.
        scan_id: None before the scan has started; "" for the next scan, whatever its id.
        scan_end: completed with the cause once the scan ends.
        final_count: completed with the message of the scan's final count.
        feedback: state of the scan so far.
        running_count: last count of a scan that goes on.
    """

    request: Request
    publish_feedback: Callable[[CountStack.Feedback], None] = lambda feedback: None
    hint: str = ""
    scan_id: str | None = None
    scan_end: Future = field(default_factory=Future)
    final_count: Future = field(default_factory=Future)
    feedback: CountStack.Feedback = field(default_factory=CountStack.Feedback)
    running_count: StackCount = field(default_factory=StackCount)
    _published: str = ""  # the feedback that was published last

    @property
    def is_cancelled(self) -> bool:
        """Whether it was ended by a cancel."""
        return self.scan_end.done() and self.scan_end.result() == "cancelled"

    def finish(self, cause: str) -> None:
        """Ends the scan, if it has not ended."""
        if not self.scan_end.done():
            self.scan_end.set_result(cause)

    def on_count(self, count: StackCount) -> None:
        """Completes the job with the final count of its scan; sends running ones as feedback."""
        if self.scan_id is None or (self.scan_id and count.scan_id != self.scan_id):
            return
        if count.region:  # which of the counts the request means, nobody has said
            self.finish("regions")
        elif count.final:
            if not self.final_count.done():
                self.final_count.set_result(count)
                self.finish("scan ended")
        elif not count.error:
            self.running_count, feedback = count, self.feedback
            feedback.count, feedback.stack_volume = count.count, count.stack_volume
            feedback.count_low, feedback.count_high = count.count_low, count.count_high
            self._publish_changed_feedback()

    def on_status(self, status: ScanStatus) -> None:
        """Sends feedback, and ends the scan once enough views are in."""
        if not self.scan_id or status.scan_id != self.scan_id or status.node != "reconstructor":
            return
        feedback, views = self.feedback, self.feedback.views
        feedback.coverage, feedback.stack_volume = status.coverage, status.stack_volume
        views.received, views.used = status.received, status.processed
        views.skip_reasons, views.skip_counts = status.skip_reasons, status.skip_counts
        self._publish_changed_feedback()
        if self.request.max_views and status.processed >= self.request.max_views:
            self.finish("views")

    def _publish_changed_feedback(self) -> None:
        """Publishes the feedback unless it says what the last one did: a report may repeat."""
        content = repr(self.feedback)  # a volume that is not known yet, NaN, is as it was
        if content != self._published:
            self._published = content
            self.publish_feedback(self.feedback)


@dataclass(frozen=True, eq=False)
class Outcome:
    """How a job ended.

    Attributes:
        message: one line for people.
        count: None where there is none.
    """

    message: str
    count: StackCount | None = None


class CountJobRunner:
    """Runs jobs by the collector's services; every wait is a future that a callback completes."""

    def __init__(self, node: ManagedNode, group: CallbackGroup):
        """Makes clients of the collector on a node that is being set up."""
        self._node = node
        self._start = node.create_client(StartScan, "start_scan", callback_group=group)
        self._stop = node.create_client(StopScan, "stop_scan", callback_group=group)

    def destroy(self) -> None:
        """Destroys the clients."""
        self._node.destroy_client(self._start)
        self._node.destroy_client(self._stop)

    async def run(self, job: CountJob, timeout_s: float) -> Outcome:
        """Runs a job to its end; a scan that has not ended after `timeout_s` is stopped."""
        # Start the scan.
        failure = await self._start_scan(job)
        if failure:
            return Outcome(failure)
        # Wait until it has enough views, is cancelled or out of time; stop it.
        cause = await self._wait_for(job.scan_end, timeout_s, "timeout")
        if not job.final_count.done() and job.scan_id:
            await self._wait_for(self._stop.call_async(StopScan.Request()), TIMEOUTS.answer_s)
        if cause == "cancelled":
            return Outcome("cancelled")
        if cause == "regions":
            return Outcome("the reconstructor names regions, and a request asks for one count; "
                           "expected no regions, or start_scan and stop_scan: the topic result "
                           "then has a count for each")
        # Wait for its count, and judge it.
        count = await self._wait_for(job.final_count, TIMEOUTS.count_s)
        hint = f"; {job.hint}" if job.hint else ""
        if count is None:
            return Outcome(f"no count within {TIMEOUTS.count_s} s of the scan's end ({cause})"
                           + hint)
        if count.error:
            return Outcome(count.error + hint)
        request = job.request
        if count.views.used < request.min_views:
            return Outcome(f"{count.views.used} views used; expected at least "
                           f"{request.min_views}{hint}")
        verdict = set_verdict(count, request.expected_count, request.tolerance)
        return Outcome(f"{verdict}; ended by {cause}", count)

    async def _start_scan(self, job: CountJob) -> str:
        """Starts the job's scan and sets its id; returns why it could not, or ""."""
        for _ in range(round(TIMEOUTS.collector_s / TIMEOUTS.collector_poll_s)):
            if self._start.service_is_ready() or job.scan_end.done():
                break
            await self._wait_for(Future(), TIMEOUTS.collector_poll_s)
        if job.scan_end.done():
            return job.scan_end.result()
        if not self._start.service_is_ready():
            return "no collector offers start_scan; expected one running"
        started = await self._wait_for(self._start.call_async(StartScan.Request(
            **to_part_fields(from_part_fields(job.request)))), TIMEOUTS.answer_s)
        if started is None or not started.accepted:
            return started.message if started else "start_scan gave no answer"
        job.scan_id, job.hint = started.scan_id, started.message
        return ""

    async def _wait_for(self, future: Future, seconds: float, otherwise: Any = None) -> Any:
        """Returns the future's result, or `otherwise` after that time."""
        first = Future()

        def complete(result: Any) -> None:
            if not first.done():
                first.set_result(result)

        timer = self._node.create_timer(
            seconds, lambda: complete(otherwise), callback_group=ReentrantCallbackGroup(),
            clock=self._node.steady)
        future.add_done_callback(lambda done: complete(done.result()))
        try:
            return await first
        finally:
            self._node.destroy_timer(timer)
