# SPDX-License-Identifier: Apache-2.0
"""The log of results: whole lines, files of one kind, bounded in size; and their schema."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

from stack_counter.display.result_log import SETTINGS, ResultLog
from stack_counter.display.result_schema import flat_line, result_schema

LINE = {"scan_id": "a", "stamp": "2026-11-27T07:00:00.000001Z", "count": 182,
        "count_interval": [170, 195], "reasons": ["one_side", "no_depth"],
        "views": {"received": 8, "used": 6, "skipped": {"no_tf": 2}}}


def read_csv(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_every_number_has_a_column_and_what_varies_is_json():
    cells = flat_line(LINE)
    assert cells["count"] == 182 and cells["views.used"] == 6
    assert [cells["count_interval.0"], cells["count_interval.1"]] == [170, 195]
    assert json.loads(cells["views.skipped"]) == {"no_tf": 2}
    assert json.loads(cells["reasons"]) == LINE["reasons"]
    assert cells["gamma"] is None and cells["container.pose.position_m.2"] is None
    assert cells.keys() == flat_line({}).keys()


def test_lines_are_added_below_one_header(tmp_path):
    path = tmp_path / "new" / "folder" / "results.csv"
    for scan in "ab":
        ResultLog(path, 1.0).append({**LINE, "scan_id": scan})
    first, second = read_csv(path)
    assert (first["scan_id"], second["scan_id"]) == ("a", "b")
    assert first["count"] == "182" and first["gamma"] == ""
    assert path.read_text().count("schema_version") == 1


def test_json_lines_are_what_was_given(tmp_path):
    log = ResultLog(tmp_path / "results.jsonl", 1.0)
    log.append(LINE)
    log.append({**LINE, "count": None})
    assert [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()] \
        == [LINE, {**LINE, "count": None}]


def test_a_text_cannot_break_its_line(tmp_path):
    names = ['one, "two"', "a\nb", "é\u2028"]
    log = ResultLog(tmp_path / "results.csv", 1.0)
    for name in names:
        log.append({**LINE, "scan_id": name})
    assert [row["scan_id"] for row in read_csv(tmp_path / "results.csv")] == names


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
def test_all_files_together_stay_within_the_size_and_the_newest_lines_are_kept(tmp_path, suffix):
    path, lines = tmp_path / f"results{suffix}", 400
    log = ResultLog(path, 0.04)
    for number in range(lines):
        log.append({**LINE, "scan_id": f"scan {number:03}"})
    files = [path, *(tmp_path / f"results.{n}{suffix}"
                     for n in range(1, 1 + SETTINGS.older_files))]
    assert {file.name for file in files} == {file.name for file in tmp_path.iterdir()}
    assert sum(file.stat().st_size for file in files) <= 40000
    kept = "".join(file.read_text() for file in reversed(files))
    numbers = [int(part[:3]) for part in kept.split("scan ")[1:]]
    assert numbers == list(range(lines - len(numbers), lines)) and len(numbers) > 100
    if suffix == ".csv":
        assert all(read_csv(file) and "count" in read_csv(file)[0] for file in files)


@pytest.mark.parametrize("before", [b"time,parts\n1,2\n", b"no newline"])
def test_a_file_of_another_kind_is_put_aside(tmp_path, before):
    (tmp_path / "results.csv").write_bytes(before)
    ResultLog(tmp_path / "results.csv", 1.0).append(LINE)
    assert (tmp_path / "results.1.csv").read_bytes() == before
    assert [row["count"] for row in read_csv(tmp_path / "results.csv")] == ["182"]


def test_a_line_cut_by_a_crash_is_put_aside_with_its_file(tmp_path):
    (tmp_path / "results.jsonl").write_text('{"count": 1}\n{"cou')
    ResultLog(tmp_path / "results.jsonl", 1.0).append(LINE)
    assert json.loads((tmp_path / "results.jsonl").read_text()) == LINE


FILL = """
import resource, sys
from pathlib import Path
from stack_counter.display.result_log import ResultLog
log = ResultLog(Path(sys.argv[1]), 1.0)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))
for line in ({"n": 1, "text": "x" * 60}, {"n": 2, "text": "x" * 60}, {"n": 3}):
    try:
        log.append(line)
    except OSError:
        print("refused", line["n"])
"""


def test_a_full_disk_leaves_whole_lines_alone(tmp_path):
    """A limit of 100 bytes to a file's size stands in for the disk: a write is cut within."""
    path = tmp_path / "results.jsonl"
    done = subprocess.run([sys.executable, "-c", FILL, str(path)], capture_output=True, text=True,
                          check=True)
    assert done.stdout == "refused 2\n"
    assert [json.loads(line)["n"] for line in path.read_text().splitlines()] == [1, 3]


def test_the_schema_in_docs_is_what_the_command_prints(capsys):
    from stack_counter.cli.main import main

    with pytest.raises(SystemExit, match="0"):
        main(["replay", "--json-schema"])
    printed = capsys.readouterr().out
    assert json.loads(printed) == result_schema()
    assert (Path(__file__).parents[2] / "docs" / "result.schema.json").read_text() == printed
