# SPDX-License-Identifier: Apache-2.0
"""Recordings of scan after scan: bounded, and never in the way of the scan."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from kits.recorder_kit import FACTS, noise, numbers, received, record, views_of, wait
from kits.recording_kit import COLOR, DEPTH, INFO, camera_info, scan, tf_record
from mcap.reader import make_reader

from stack_counter.bag import recorder as recorder_module
from stack_counter.bag.reader import BagReader
from stack_counter.bag.recorder import Recorder, RecorderSettings
from stack_counter.bag.scan_file import Recording
from stack_counter.errors import ConfigError

BIG = 1000.0  # MB


@pytest.fixture
def said():
    """Warnings of the recorders of a test."""
    return []


@pytest.fixture
def make(tmp_path, said):
    """Recorders in the test's folder; all are closed."""
    made = []

    def make(max_mb=BIG, folder=tmp_path):
        made.append(Recorder(folder, max_mb, said.append))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_what_came_before_the_scan_is_at_its_start(tmp_path, make):
    recorder, now_ns, T = make(), time.time_ns(), np.eye(4)

    def take(record, age_s, key=None):
        recorder.take(received(record, now_ns - age_s * 10**9), key)

    take(tf_record(1, T, topic="/tf_static"), 1000, "static")
    take(tf_record(2, T, topic="/tf_static"), 900, "static")  # in place of the first
    take(tf_record(3, T), 100)  # too old for any view to come
    for stamp, age_s in ((4, 50), (5, 2)):
        take(tf_record(stamp, T), age_s)
    for stamp, age_s in ((6, 3), (7, 1)):
        take((stamp, INFO, "sensor_msgs/msg/CameraInfo", camera_info(scan()[0].intrinsics)),
             age_s, INFO)
    recorder.take(noise(8))  # an image of no scan
    recorder.start(FACTS)
    recorder.take(noise(9))
    recorder.stop("stop_scan")
    recorder.take(noise(10))
    record(recorder, [noise(11)], "second")  # it, too, begins with what came before
    recorder.close()
    for path, image in zip(sorted(tmp_path.iterdir()), (9, 11)):
        with open(path, "rb") as file:
            messages = [m for _, _, m in make_reader(file).iter_messages(log_time_order=False)]
        assert [m.publish_time for m in messages] == [2, 4, 5, 7, image]
        times = [m.log_time for m in messages]
        assert times == sorted(set(times)) and times[0] > now_ns - 10**9


def test_the_order_of_arrival_survives_a_clock_that_is_put_back(tmp_path, make):
    recorder = make()
    record(recorder, [noise(i, 10)._replace(received_ns=10**18 - i) for i in range(5)])
    recorder.close()
    path, = tmp_path.iterdir()
    assert numbers(path) == list(range(5))


def test_an_image_is_in_the_file_at_once_and_transforms_soon(tmp_path, make, monkeypatch):
    tf = received(tf_record(1, np.eye(4)))

    def written(topic, where):
        return [p for p in tmp_path.glob(where) if topic in BagReader(p).topics]

    monkeypatch.setattr(recorder_module, "SETTINGS", RecorderSettings(flush_s=1000.0))
    recorder = make()
    recorder.start(FACTS)
    recorder.take(tf)
    recorder.take(noise(1))
    wait(lambda: written("/noise", "*.part"), "the image")
    recorder.stop("stop_scan")
    monkeypatch.setattr(recorder_module, "SETTINGS", RecorderSettings(flush_s=0.1))
    recorder = make(folder=tmp_path / "other")
    recorder.start(FACTS)
    recorder.take(tf)
    wait(lambda: written("/tf", "other/*.part"), "the transforms")


def test_a_killed_recorder_leaves_its_images_and_the_next_gives_them_a_name(tmp_path, make, said):
    code = ("import pathlib, sys\nfrom kits import recorder_kit as kit\n"
            "from stack_counter.bag.recorder import Recorder\n"
            "r = Recorder(pathlib.Path(sys.argv[1]), 1000.0, print)\n"
            "r.start(kit.FACTS)\n[r.take(m) for m in kit.camera()]\nsys.stdin.read()")
    child = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE,
                             env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})

    def images():
        parts = [path for path in tmp_path.glob("*.part") if path.stat().st_size]
        topics = BagReader(parts[0]).topics if parts else {}
        return min(topics.get(name, ("", 0))[1] for name in (COLOR, DEPTH))

    try:
        wait(lambda: images() == 6, "six images")
        make()  # a second recorder in the same folder leaves it to its writer
        assert not said and [p.suffix for p in tmp_path.iterdir()] == [".part"]
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
    make()
    left, = tmp_path.iterdir()
    assert left.name.endswith("_a.cut.mcap") and str(left) in said[0] and len(said) == 1
    assert len(views_of(left)) == 6 and BagReader(left).truncated


def test_the_oldest_go_first_and_foreign_files_stay(tmp_path, make, said):
    foreign = {"scan_1.mcap", "notes.txt", "keep_scan_20200101-000000-000_a.mcap",
               "scan_20200101-000000-000_a.mcap.bak", "scan_20200101-000000-0000_a.mcap"}
    for name in foreign:
        (tmp_path / name).write_bytes(bytes(2_000_000))
    (tmp_path / "scan_20200101-000000-000_folder.mcap").mkdir()
    recorder, most = make(max_mb=1.5), 0

    def ours():
        return {p.name: p.stat().st_size for p in tmp_path.iterdir()
                if p.is_file() and p.name not in foreign}

    for number in range(5):
        record(recorder, [noise(i) for i in range(5)], str(number))  # of 0.5 MB each
        wait(lambda n=number: any(x.endswith(f"_{n}.mcap") for x in ours()), f"scan {number}")
        most = max(most, sum(ours().values()))
    assert [name[-6] for name in sorted(ours())] == ["3", "4"]
    assert 1_000_000 < most <= 1_500_000
    assert foreign < {p.name for p in tmp_path.iterdir()} and not said


def test_a_scan_above_the_bound_is_cut_and_says_so(tmp_path, make, said):
    recorder = make(max_mb=1.0)
    record(recorder, [noise(0)], "first")
    record(recorder, [noise(i) for i in range(30)], "long")
    wait(lambda: list(tmp_path.glob("*_long.cut.mcap")), "the cut recording")
    path, = tmp_path.iterdir()  # the first made room
    assert path.stat().st_size <= 1_000_000 and numbers(path) == list(range(9))
    reader = BagReader(path)
    assert reader.truncated and reader.facts["ended"].startswith("cut: the scan alone takes 1 MB")
    assert len(said) == 1 and "scan 'long' is cut" in said[0]
    record(recorder, [noise(0)], "last")
    recorder.close()
    assert [p.name[24:] for p in tmp_path.iterdir()] == ["_last.mcap"]


def test_a_full_disk_ends_the_recording_alone(tmp_path, make, said):
    recorder, limits = make(), resource.getrlimit(resource.RLIMIT_FSIZE)
    record(recorder, [noise(1)], "before")
    wait(lambda: list(tmp_path.glob("*_before.mcap")), "the first scan")
    resource.setrlimit(resource.RLIMIT_FSIZE, (250_000, limits[1]))
    try:
        record(recorder, [noise(i) for i in range(9)], "full")
        wait(lambda: said, "a warning")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    record(recorder, [noise(2)], "after")
    recorder.close()
    assert [p.name[24:] for p in sorted(tmp_path.iterdir())] == ["_before.mcap", "_after.mcap"]
    assert len(said) == 1 and "stopped and removed, the scan goes on" in said[0]
    assert "File too large" in said[0]


def test_a_folder_that_vanishes_is_said_once_a_scan(tmp_path, make, said):
    recorder = make(folder=tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    record(recorder, [noise(i) for i in range(3)])
    recorder.close()
    assert len(said) == 1 and "No such file" in said[0]


def test_a_disk_that_hangs_does_not_hold_the_scan_up(tmp_path, make, said, monkeypatch):
    goes_on, write = threading.Event(), Recording.write
    monkeypatch.setattr(recorder_module, "SETTINGS",
                        RecorderSettings(max_backlog_bytes=1_000_000))
    monkeypatch.setattr(Recording, "write",
                        lambda self, message: goes_on.wait(60) and write(self, message))
    recorder = make()
    record(recorder, [noise(i) for i in range(30)])  # returns though nothing is written
    goes_on.set()
    recorder.close()
    path, = tmp_path.iterdir()
    assert path.name.endswith("_a.cut.mcap") and 9 <= len(numbers(path)) <= 13
    assert len(said) == 1 and "1 MB wait for the disk" in said[0]


def test_a_folder_that_cannot_be_is_a_fault_of_the_settings(tmp_path, make):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="record_folder is '.*file': .*; expected a folder"):
        make(folder=tmp_path / "file")
