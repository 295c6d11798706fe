# SPDX-License-Identifier: Apache-2.0
"""`stack-counter play`: a recording into nodes that run."""

import os
import signal
import subprocess
import sys
from dataclasses import replace

import pytest
from geometry_msgs.msg import TransformStamped
from kits.bags import bag
from kits.command import run
from kits.harness import PATIENCE_S, StandInReconstructor
from kits.recording_kit import IMAGE, image, write
from sensor_msgs.msg import CameraInfo
from stack_counter_msgs.srv import StartScan
from tf2_msgs.msg import TFMessage

from stack_counter.cli import main
from stack_counter.ros import bag_player
from stack_counter.ros.bag_player import SETTINGS, StampShift, playable_topics
from stack_counter.ros.private_domain import PrivateDomain
from stack_counter.ros.standard_messages import to_header
from stack_counter.views.decoding import stamp_ns

SPACE = "/stack_counter"


def play(ros, path, *arguments):
    """Starts the command beside the nodes; what it prints goes to a pipe."""
    return subprocess.Popen(
        [sys.executable, "-m", "stack_counter", "play", str(path), *arguments], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env={**os.environ, **ros.environment})


def test_a_recording_is_played_into_a_collector_and_again_in_a_loop(ros, tmp_path):
    ros.start("collector")  # which has raw colour images as its first guess
    assert ros.call(StartScan, f"{SPACE}/start_scan", StartScan.Request(scan_id="a")).accepted
    path, taker = bag(tmp_path), StandInReconstructor(ros, subscribers=2)
    once = play(ros, path, "--rate", "6")
    ros.wait(lambda: len(taker.images) == 6, "the six views of the bag")
    out, _ = once.communicate(timeout=PATIENCE_S)
    assert once.returncode == 0
    assert f"playing {path}: 36 messages on 4 topics\n" in out
    assert "\n       6  /camera/color/image_raw/compressed  sensor_msgs/msg/Compressed" in out
    assert "nobody" not in out
    assert [m.header.stamp.sec for m in taker.images] == [1, 2, 3, 4, 5, 6], "as recorded"

    loop = play(ros, path, "--rate", "6", "--loop")
    ros.wait(lambda: len(taker.images) >= 6 + 5 + 5, "a second repetition")
    loop.send_signal(signal.SIGTERM)
    out, _ = loop.communicate(timeout=PATIENCE_S)
    assert loop.returncode == 130 and "Traceback" not in out
    assert "from the beginning; stamps are later by 6.0 s\n" in out
    stamps = [stamp_ns(m.header.stamp) for m in taker.images[6:]]
    assert stamps == sorted(set(stamps))


def test_who_plays_to_nobody_reads_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bag_player, "SETTINGS", replace(SETTINGS, match_s=0.1))
    with PrivateDomain() as domain:
        for name, value in domain.environment.items():
            monkeypatch.setenv(name, value)
        code, out, _ = run(capsys, "play", bag(tmp_path), "--rate", "100")
    assert code == 0
    assert f"nobody subscribes to any of them on ROS domain {os.environ['ROS_DOMAIN_ID']};" in out


def test_stamps_go_on_where_the_repetition_before_has_ended():
    shift = StampShift()

    def played(topic, stamps_ns):
        messages = [TFMessage(transforms=[TransformStamped(header=to_header(stamp, "w"))
                                          for stamp in stamps_ns])]
        messages += [CameraInfo(header=to_header(stamp, "c")) for stamp in stamps_ns]
        for message in messages:
            shift.apply(topic, message)
        return [stamp_ns(t.header.stamp) for t in messages[0].transforms], \
            [stamp_ns(m.header.stamp) for m in messages[1:]]

    stamps = [10**9, 3 * 10**9, 2 * 10**9]
    later = 2 * 10**9 + SETTINGS.loop_gap_ns
    for repetition in range(3):
        assert played("/tf", stamps) == ([s + repetition * later for s in stamps],) * 2
        assert played("/tf_static", [5])[1] == [5 + repetition * later], "it says no duration"
        assert played("/tf", [0])[1] == [0]
        shift.repeat()


def test_what_is_not_played_is_named(tmp_path, capsys):
    types, refused = playable_topics({
        "/tf": ("tf2_msgs/msg/TFMessage", 1), "/x": ("no_such_msgs/msg/X", 1), "/y": ("odd", 1),
        f"{SPACE}/volume": ("stack_counter_msgs/msg/StackVolume", 1)})
    assert types == {"/tf": TFMessage}
    assert "no_such_msgs/msg/X is not installed" in refused["/x"] and "odd" in refused["/y"]
    assert "our own nodes" in refused[f"{SPACE}/volume"]
    own = write(tmp_path / "own", [(1, f"{SPACE}/x", IMAGE, image([[1]], "mono8"))])
    code, out, err = run(capsys, "play", own)
    assert code == 3 and f"not played: {SPACE}/x" in out and "no topic that can be played" in err
    assert run(capsys, "play", tmp_path / "none")[0] == 2
    with pytest.raises(SystemExit):
        main(["play", str(own), "--rate", "0"])
