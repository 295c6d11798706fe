# SPDX-License-Identifier: Apache-2.0
"""A recount: every bag has a row, nothing is counted twice, errors are rows, a killed run goes on.
"""

import json
import os
import shutil
from dataclasses import replace

import pytest
from kits.bags import bag, bin_views
from kits.command import run

from stack_counter.archive import recount as recount_module
from stack_counter.archive.bag_counter import BagCounter, BagTask
from stack_counter.archive.digests import settings_digest
from stack_counter.archive.journal import FILE
from stack_counter.archive.recount import Recount, recount
from stack_counter.bag.replay import replay_direct
from stack_counter.config import Config, CounterConfig
from stack_counter.errors import LostWorkerError
from stack_counter.parts.catalogue import Part
from stack_counter.types import PartRequest

pytest.importorskip("pyarrow", reason="no pyarrow: pip install 'stack_counter[archive]'")
CONFIG = Config(counter=CounterConfig(estimator="prior"))
BOLT = PartRequest("", 1.5e-6)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """Two bags, and a file that is none."""
    folder = tmp_path_factory.mktemp("archive")
    for name, fill in (("a", 0.03), ("b", 0.05)):
        bag(folder, bin_views(fill=fill, count=3), name)
    (folder / "c.mcap").write_text("nonsense")
    return folder


@pytest.fixture(scope="module")
def replayed(archive):
    """What the first bag gives."""
    return replay_direct(archive / "a", CONFIG, Part(1.5e-6))


@pytest.fixture
def counted(monkeypatch, replayed):
    """Runs tasks in this process, where every bag gives the first one's count.

    Gives the names of the bags that were read, with a + where they were counted.
    """
    names = []

    def run_here(function, tasks, workers):
        for task in tasks:
            names.append(task.bag.name)
            yield task, Done(function(task))

    def count(path, *_, **__):
        names[-1] += "+"
        return replayed
    monkeypatch.setattr(recount_module, "run_tasks", run_here)
    monkeypatch.setattr("stack_counter.archive.bag_counter.replay_direct", count)
    return names


class Done:
    """A future that is done."""

    def __init__(self, outcome=None, error=None):
        self.result, self.exception = lambda: outcome, lambda: error


def job(archive, out, **changes):
    bags = tuple(archive / name for name in ("a", "b", "c.mcap"))
    return Recount(**{"bags": bags, "out": out, "config": CONFIG, "request": BOLT, **changes})


def counts(outcomes):
    return [outcome.results[0]["count"] for outcome in outcomes]


def test_a_bag_is_counted_as_replay_does(archive, tmp_path, replayed):
    outcome = counter(tmp_path, request=BOLT)(BagTask(archive / "a"))
    (line,), (expected,) = outcome.results, replayed
    assert (line["count"], line["gamma"], line["volume_m3"]) == (
        expected.count.count, expected.count.gamma, expected.count.volume.stack_volume)
    assert (line["stamp"], line["verdict"]) == ("1970-01-01T00:00:03.000000Z", "none")


def test_what_is_there_is_not_counted_again(archive, tmp_path, counted):
    outcomes, there = recount(job(archive, tmp_path))
    assert there == 0 and [outcome.exit_code for outcome in outcomes] == [0, 0, 3]
    assert "c.mcap is no recording" in outcomes[2].results[0]["error"]
    again, there = recount(job(archive, tmp_path))
    assert counted == ["a+", "b+", "c.mcap"] and there == 3 and again == outcomes
    assert {path.name for path in tmp_path.iterdir()} == {
        FILE, "results.csv", "results.parquet", "summary.html"}


@pytest.mark.parametrize("changes", [
    {"config": replace(CONFIG, counter=replace(CONFIG.counter, confidence=0.8))},
    {"request": PartRequest("", 3e-6)}])
def test_other_settings_or_another_part_count_again(archive, tmp_path, counted, changes):
    recount(job(archive, tmp_path))
    recount(job(archive, tmp_path, **changes))
    assert counted[3:5] == ["a+", "b+"]


def test_another_version_counts_again(archive, tmp_path, counted, monkeypatch):
    recount(job(archive, tmp_path))
    for module in ("recount", "bag_counter"):
        monkeypatch.setattr(f"stack_counter.archive.{module}.__version__", "9.0")
    outcomes, there = recount(job(archive, tmp_path))
    assert there == 0 and {outcome.version for outcome in outcomes} == {"9.0"}
    rows = (tmp_path / "results.csv").read_text().splitlines()
    assert len(rows) == 1 + 5, "two versions of two counts; of the file that is none one"


def test_a_run_that_was_killed_goes_on_where_it_was(archive, tmp_path, counted):
    recount(job(archive, tmp_path))
    journal = tmp_path / FILE
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(lines[0] + lines[1][:-100])  # killed as it wrote the second
    outcomes, there = recount(job(archive, tmp_path))
    assert counted[3:] == ["b+", "c.mcap"] and there == 1
    assert len(journal.read_bytes().splitlines()) == len(outcomes) == 3


def test_a_copy_is_not_counted_and_a_changed_bag_is(archive, tmp_path, counted):
    shutil.copytree(archive, tmp_path / "bags")
    recount(job(archive, tmp_path / "out"))
    outcomes, there = recount(job(tmp_path / "bags", tmp_path / "out"))
    assert counted[3:] == ["a", "b", "c.mcap"] and there == 0
    assert [outcome.exit_code for outcome in outcomes] == [0, 0, 3]
    (tmp_path / "bags/b/b.mcap").write_bytes(b"nonsense")
    os.utime(tmp_path / "bags/a/a.mcap")
    outcomes, there = recount(job(tmp_path / "bags", tmp_path / "out"))
    assert counted[6:] == ["a", "b"] and there == 1
    assert [outcome.exit_code for outcome in outcomes] == [0, 3, 3]


def test_chance_is_tried_again(archive, tmp_path, monkeypatch):
    def lose(function, tasks, workers):
        yield from ((task, Done(error=LostWorkerError("lost 3 times"))) for task in tasks)
    monkeypatch.setattr(recount_module, "run_tasks", lose)
    outcomes, _ = recount(job(archive, tmp_path))
    assert [(o.exit_code, o.results[0]["error"]) for o in outcomes] == [(1, "lost 3 times")] * 3
    _, there = recount(job(archive, tmp_path))
    assert there == 0
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 1 + 3


def test_what_interrupts_a_run_leaves_tables_of_what_it_has(archive, tmp_path, counted,
                                                            monkeypatch):
    def interrupt(function, tasks, workers):
        counted.append("a")
        yield tasks[0], Done(function(tasks[0]))
        raise KeyboardInterrupt
    monkeypatch.setattr(recount_module, "run_tasks", interrupt)
    with pytest.raises(KeyboardInterrupt):
        recount(job(archive, tmp_path))
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 1 + 1


def test_reports_that_are_missing_are_made(archive, tmp_path, counted, monkeypatch):
    def write(folder, *_):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "report.html").touch()
    monkeypatch.setattr("stack_counter.archive.bag_counter.write_report", write)
    reports = job(archive, tmp_path, bags=(archive / "a",), reports=True)
    recount(job(archive, tmp_path))
    (first,), there = recount(reports)
    assert there == 0 and (tmp_path / first.results[0]["report"]).is_file()
    assert recount(reports)[1] == 1
    (tmp_path / first.results[0]["report"]).unlink()
    assert recount(reports)[1] == 0 and (tmp_path / first.results[0]["report"]).is_file()


def counter(out, **changes):
    values = {"config": CONFIG, "request": PartRequest(), "settings": settings_digest(CONFIG),
              "version": recount_module.__version__, "known": frozenset(), "out": out, **changes}
    return BagCounter(**values)


@pytest.mark.parametrize("facts, part", [
    ({"part": "demo_nut", "unit_volume_m3": "1e-06"}, ("demo_nut", 0.0, [0.0] * 3)),
    ({"part": "gone", "unit_volume_m3": "1e-06", "part_size_m": "0.02 0.01 0.01"},
     ("gone", 1e-6, [0.02, 0.01, 0.01])),
    ({"part": "", "unit_volume_m3": "2e-06"}, ("", 2e-6, [0.0] * 3))])
def test_a_recording_names_its_part(archive, tmp_path, counted, monkeypatch, facts, part):
    counted.append("")
    monkeypatch.setattr("stack_counter.archive.bag_counter.BagReader",
                        lambda path: type("Reader", (), {"facts": facts}))
    assert counter(tmp_path)(BagTask(archive / "a")).part == part


def test_without_a_part_a_bag_is_not_counted(archive, tmp_path):
    outcome = counter(tmp_path)(BagTask(archive / "a"))
    assert outcome.exit_code == 2 and not outcome.is_final
    assert "no part named and no unit volume given" in outcome.results[0]["error"]


def test_a_worker_of_another_version_counts_nothing(archive, tmp_path):
    outcome = counter(tmp_path, version="9.0", request=BOLT)(BagTask(archive / "a"))
    assert outcome.exit_code == 2
    assert "on this machine; expected 9.0" in outcome.results[0]["error"]


def test_a_defect_is_a_row(archive, tmp_path, monkeypatch):
    monkeypatch.setattr("stack_counter.archive.bag_counter.replay_direct", None)
    outcome = counter(tmp_path, request=BOLT)(BagTask(archive / "a"))
    assert outcome.exit_code == 1 and not outcome.is_final
    assert outcome.results[0]["error"].startswith("TypeError: 'NoneType'")


def test_the_command(archive, tmp_path, capsys):
    """In a process of its own."""
    out, bags = tmp_path / "out", tmp_path / "list.txt"
    bags.write_text(f"{archive}/a\n{archive}/c.mcap\n{archive}/gone\n")
    words = ["recount", bags, "--out", out, "--part", "demo_nut", "--report"]
    code, text, _ = run(capsys, *words)
    assert code == 0
    assert text == f"3 bags: 1 with a count, 2 without; 0 were there before\n{out}/summary.html\n"
    rows = [json.loads(line) for line in (out / FILE).read_text().splitlines()]
    (report,) = [row["results"][0]["report"] for row in rows if not row["exit_code"]]
    assert (out / report).is_file() and report in (out / "summary.html").read_text()
    assert sorted(row["exit_code"] for row in rows) == [0, 2, 3]


@pytest.mark.parametrize("words, said", [
    (["none"], "no archive none"), (["{archive}", "--part", "no_such"], "unknown part 'no_such'"),
    (["{archive}", "--config", "none.yaml"], "none.yaml")])
def test_what_keeps_every_bag_from_being_counted_ends_the_command(archive, tmp_path, capsys,
                                                                   words, said):
    words = [word.format(archive=archive) for word in words]
    code, _, error = run(capsys, "recount", *words, "--out", tmp_path / "out")
    assert code == 2 and said in error and not (tmp_path / "out").exists()
