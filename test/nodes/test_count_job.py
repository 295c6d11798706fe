# SPDX-License-Identifier: Apache-2.0
"""What ends a count that was asked for."""

import math
from types import SimpleNamespace

from rclpy.task import Future
from stack_counter_msgs.action import CountStack
from stack_counter_msgs.msg import ScanStatus, StackCount
from stack_counter_msgs.srv import StartScan, StopScan

from stack_counter.nodes.count_job import CountJob, CountJobRunner


def test_the_final_count_of_its_scan_ends_it():
    job = CountJob(CountStack.Goal(), scan_id="a")
    job.on_count(StackCount(scan_id="b", final=True))
    job.on_count(StackCount(scan_id="a", count=4))
    assert not job.scan_end.done() and job.running_count.count == 4
    job.on_count(StackCount(scan_id="a", final=True, count=5))
    assert job.scan_end.result() == "scan ended" and job.final_count.result().count == 5


def test_the_count_of_one_of_several_regions_is_never_its_answer():
    job = CountJob(CountStack.Goal(), scan_id="a")
    job.on_count(StackCount(scan_id="a", region="left", count=4, final=True))
    assert job.scan_end.result() == "regions" and not job.final_count.done()
    assert job.running_count.count == 0


def test_feedback_is_sent_only_when_it_says_something_new():
    sent = []
    job = CountJob(CountStack.Goal(), lambda feedback: sent.append(feedback.views.used),
                   scan_id="a")
    for used in (0, 0, 1, 1, 1, 2):  # the reconstructor repeats what it has, its volume unknown
        job.on_status(ScanStatus(node="reconstructor", scan_id="a", processed=used,
                                 stack_volume=math.nan))
    assert sent == [0, 1, 2]
    for number in (7, 7, 8):
        job.on_count(StackCount(scan_id="a", count=number))
    assert len(sent) == 5


def test_a_cancel_is_told_from_other_ends():
    job = CountJob(CountStack.Goal())
    assert not job.is_cancelled
    job.finish("timeout")
    job.finish("cancelled")
    assert not job.is_cancelled
    other = CountJob(CountStack.Goal())
    other.finish("cancelled")
    assert other.is_cancelled


class Client:
    """Answers every request at once, and then makes a call."""

    def __init__(self, answer, call):
        self.answer, self.call = answer, call

    def service_is_ready(self):
        return True

    def call_async(self, request):
        future = Future()
        future.set_result(self.answer)
        self.call()
        return future


def test_what_the_collector_said_at_the_start_explains_why_there_is_no_count():
    job = CountJob(CountStack.Goal())
    started = StartScan.Response(accepted=True, scan_id="a", message="/c has 1 publisher")
    failed = StackCount(scan_id="a", final=True, error="0 views used")
    clients = {"start_scan": Client(started, lambda: job.finish("views")),
               "stop_scan": Client(StopScan.Response(), lambda: job.on_count(failed))}
    node = SimpleNamespace(create_client=lambda kind, name, callback_group: clients[name],
                           create_timer=lambda *args, **kwargs: None, steady=None,
                           destroy_timer=lambda timer: None)
    run = CountJobRunner(node, None).run(job, 1.0)
    try:
        run.send(None)
    except StopIteration as end:
        assert end.value.message == "0 views used; /c has 1 publisher"
    else:
        raise AssertionError("it waits though all is there")
