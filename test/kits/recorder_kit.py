# SPDX-License-Identifier: Apache-2.0
"""Messages for the recorder, and ways to look at what it has written."""

import time

import numpy as np
from kits.recording_kit import IMAGE, STORE, records, scan

from stack_counter.bag.bag_views import read_views
from stack_counter.bag.camera_topics import fit_rig_to_bag
from stack_counter.bag.reader import BagReader
from stack_counter.bag.recorder import Received
from stack_counter.config import CollectorConfig
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

FACTS = {"scan_id": "a", "part": "nut", "unit_volume_m3": "2e-06", "version": "0"}


def received(record, now_ns=0):
    stamp_ns, topic, kind, message = record
    return Received(topic, kind, bytes(STORE.serialize_cdr(message, kind)), stamp_ns,
                    now_ns or time.time_ns())


def camera(count=6):
    """The messages of a camera and an arm, in their order."""
    return [received(r) for r in sorted(records(scan(count=count)), key=lambda r: r[0])]


def noise(number, size=100_000):
    """An image message that does not compress; its first bytes are its number."""
    data = number.to_bytes(4, "little") + np.random.default_rng(number).bytes(size)
    return Received("/noise", IMAGE, data, number, time.time_ns())


def numbers(path):
    return [int.from_bytes(r.data[:4], "little") for r in BagReader(path).records({"/noise"})]


def record(recorder, messages, scan_id="a"):
    recorder.start({**FACTS, "scan_id": scan_id})
    for message in messages:
        recorder.take(message)
    recorder.stop("stop_scan")


def views_of(path):
    reader = BagReader(path)
    rig = fit_rig_to_bag(load_rig(CollectorConfig()), reader.topics)
    assembler = RigAssembler(rig, live=False)
    views = [view for _, view in read_views(reader, assembler)]
    assert not assembler.tally.skipped
    return views


def wait(condition, what):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, f"waited 60 s for {what}"
        time.sleep(0.01)
