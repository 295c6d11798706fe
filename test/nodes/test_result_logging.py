# SPDX-License-Identifier: Apache-2.0
"""The lines that final counts become; no node is started."""

from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time
from kits.result_schema import read_result
from stack_counter_msgs.msg import (
    CellFillingLevel,
    Container,
    GridSize,
    StackCount,
    StackVolume,
    StageSeconds,
    ViewTally,
)
from std_msgs.msg import Header

from stack_counter.config import CounterConfig
from stack_counter.display.report import as_dict
from stack_counter.display.result_schema import flat_line
from stack_counter.errors import ConfigError
from stack_counter.nodes.result_logging import ResultLogging
from stack_counter.ros.conversions import failed_count, from_stack_count, from_stack_volume
from stack_counter.ros.diagnostics import WARN
from stack_counter.ros.result_line import result_line, to_flat_json

HEADER = Header(stamp=Time(sec=1_700_000_000, nanosec=123_456_789), frame_id="cell")


def counted(**fields):
    """A final volume and its count."""
    views = ViewTally(received=8, used=6, skip_reasons=["no_tf"], skip_counts=[2])
    volume = StackVolume(header=HEADER, scan_id="scan 7", region="left", part="nut", final=True,
                         unit_volume=1e-6, stack_volume=1e-3, stack_volume_std=1e-5, coverage=0.9,
                         container=Container(kind="box"), views=views,
                         filling_level_cell_count=GridSize(x=2, y=1),
                         cells_filling_levels=[CellFillingLevel(coverage=0.9)] * 2)
    count = StackCount(header=HEADER, scan_id="scan 7", region="left", part="nut", final=True,
                       count=600, count_low=550, count_high=650, confidence=0.9, gamma=0.6,
                       gamma_std=0.02, unit_volume=1e-6, stack_volume=1e-3, views=views,
                       gamma_sources=["estimator"], gamma_shares=[1.0], estimator="network",
                       verdict=StackCount.VERDICT_PASS, reasons=["one_side"],
                       seconds=StageSeconds(stages=["gamma"], seconds=[0.1]))
    for name, value in fields.items():
        setattr(count, name, value)
    return count, volume


def logging_to(path):
    """Logging to a file, and the list of its warnings."""
    warnings = []
    logger = SimpleNamespace(warning=lambda text, **_: warnings.append(text))
    return ResultLogging(CounterConfig(result_log=str(path)), logger), warnings


def test_a_line_says_whose_count_it_is_and_what_replay_says(tmp_path):
    count, volume = counted()
    log, warnings = logging_to(tmp_path / "results.jsonl")
    log.write(count, volume)
    line = read_result((tmp_path / "results.jsonl").read_text(), "log_line")
    own = {"scan_id": "scan 7", "stamp": "2023-11-14T22:13:20.123456Z", "region": "left",
           "part": "nut", "verdict": "pass"}
    replayed = as_dict(from_stack_count(count, from_stack_volume(volume)), [])
    assert replayed.pop("counts") == [] and replayed.pop("filling_level_cell_count") == {
        "x": 2, "y": 1}
    # What is long is left out.
    assert len(replayed.pop("cells_filling_levels")) == 2 and replayed.pop("visible_parts") == []
    assert line == own | replayed
    assert not warnings and log.status_lines() == []


def test_a_failed_count_is_a_line_with_its_reason(tmp_path):
    _, volume = counted()
    log, _ = logging_to(tmp_path / "results.jsonl")
    log.write(failed_count("2 views used; expected 3 or more", volume), volume)
    line = read_result((tmp_path / "results.jsonl").read_text(), "log_line")
    assert line["count"] is None and line["status"] == "error" and line["part"] == "nut"
    assert line["error"].startswith("2 views used") and line["views"]["skipped"] == {"no_tf": 2}


def test_the_flat_json_has_every_value_of_the_line_by_one_name():
    count, volume = counted()
    flat = read_result(to_flat_json(count, volume).data, "flat")
    assert flat == flat_line(result_line(count, volume))
    assert (flat["count"], flat["count_interval.1"], flat["views.used"]) == (600, 650, 6)
    assert (flat["reasons"], flat["views.skipped"]) == ('["one_side"]', '{"no_tf": 2}')
    failed = read_result(to_flat_json(failed_count("2 views used", volume), volume).data, "flat")
    assert failed["status"] == "error" and failed["error"] == "2 views used"
    assert failed["count"] is None and failed["count_interval.0"] is None
    assert failed.keys() == flat.keys()
    assert not any(isinstance(value, (dict, list)) for value in flat.values())


def test_every_key_of_a_line_has_a_column():
    count, volume = counted()

    def leaves(value):
        return sum(map(leaves, value.values())) if isinstance(value, dict) and len(value) > 1 \
            else len(value) if isinstance(value, list) and len(value) in (2, 3, 4) else 1

    line = result_line(count, volume)
    assert len(flat_line({})) == leaves(line) + 1  # and that of the error


def test_running_counts_and_no_log_write_nothing(tmp_path):
    log, _ = logging_to(tmp_path / "results.csv")
    log.write(*counted(final=False))
    ResultLogging(CounterConfig(), None).write(*counted())
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_written_is_said_until_it_can_be(tmp_path):
    blocked = tmp_path / "folder"
    blocked.write_text("a file where the folder should be")
    log, warnings = logging_to(blocked / "results.csv")
    for _ in range(2):
        log.write(*counted())
    (level, line), = log.status_lines()
    assert level == WARN and line == warnings[-1]
    assert "folder" in line and "2 results are not in it" in line and "\n" not in line
    blocked.unlink()
    log.write(*counted())
    assert log.status_lines() == [] and len((blocked / "results.csv").read_text().split("\n")) == 3


@pytest.mark.parametrize("name", ["results.txt", "results", "results.csv.gz"])
def test_a_name_that_does_not_say_how_to_write_is_refused(name):
    with pytest.raises(ConfigError, match="expected a file that ends in .csv or .jsonl"):
        CounterConfig(result_log=name)
