# SPDX-License-Identifier: Apache-2.0
"""Tasks: each is done once, whoever is killed, by processes and on Ray alike."""

import argparse
import os
import sys

import pytest
from kits.tasks import Squares

from stack_counter.errors import ConfigError, LostWorkerError
from stack_counter.tasks.workers import Workers, map_tasks, run_tasks


@pytest.fixture(autouse=True)
def no_threads_chosen(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)


def results(function, numbers, workers):
    """Square, or error, by number; each number comes once."""
    given = [(number, done.exception() or done.result()[0])
             for number, done in run_tasks(function, numbers, workers)]
    assert len(dict(given)) == len(given)
    return dict(given)


def test_a_worker_keeps_the_function_and_uses_one_thread():
    done = [future.result() for _, future in run_tasks(Squares(), range(4), Workers(1))]
    assert done == [(n * n, "1", list(range(n + 1))) for n in range(4)]
    assert "OMP_NUM_THREADS" not in os.environ


def check_killed_workers(tmp_path, workers):
    function = Squares(killed_once=1, note=tmp_path / "note", killed=3, wrong=5)
    got = results(function, range(8), workers)
    assert {n: got[n] for n in (0, 1, 2, 4, 6, 7)} == {n: n * n for n in (0, 1, 2, 4, 6, 7)}
    assert type(got[5]) is ValueError and str(got[5]) == "5 is wrong"
    assert isinstance(got[3], LostWorkerError) and "lost 3 times" in str(got[3])


def test_only_the_task_of_a_killed_worker_begins_again(tmp_path):
    check_killed_workers(tmp_path, Workers(2))


@pytest.mark.skipif(not os.environ.get("STACK_COUNTER_TEST_RAY"),
                    reason="Ray takes 10 s to start: STACK_COUNTER_TEST_RAY=1 runs this")
def test_ray_does_what_processes_do(tmp_path, monkeypatch):
    pytest.importorskip("ray", reason="no ray: pip install 'stack_counter[archive]'")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    check_killed_workers(tmp_path, Workers(ray="local"))


def test_without_ray_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match=r"ray, which is not installed; expected pip install "
                                          r"'stack_counter\[archive\]'$"):
        next(run_tasks(abs, [1], Workers(ray="local")))


def test_where_no_cluster_answers_one_line_says_so():
    with pytest.raises(ConfigError, match="no Ray cluster at '127.0.0.1:1': .*refused; expected "
                                          "the address of one, HOST:6379, or 'local'$"):
        next(run_tasks(abs, [1], Workers(ray="127.0.0.1:1")))


@pytest.mark.parametrize("workers", [Workers(1), Workers(2)])
def test_mapped_tasks_keep_their_order(workers):
    assert list(map_tasks(abs, range(-5, 0), workers)) == [5, 4, 3, 2, 1]
    with pytest.raises(TypeError, match="bad operand"):
        list(map_tasks(abs, [1, "a"], workers))


def test_without_tasks_nothing_is_started():
    assert not list(run_tasks(abs, [], Workers(ray="no-such-host:1")))


@pytest.mark.parametrize("words, expected", [
    ([], Workers()), (["--workers", "3"], Workers(3)), (["--ray", "local"], Workers(1, "local"))])
def test_the_command_line_says_where(words, expected):
    parser = argparse.ArgumentParser()
    Workers.add_arguments(parser)
    assert Workers.of(parser.parse_args(words)) == expected


@pytest.mark.parametrize("words", [["--workers", "0"], ["--workers", "2", "--ray", "local"]])
def test_what_cannot_be_is_refused(words, capsys):
    parser = argparse.ArgumentParser()
    Workers.add_arguments(parser)
    with pytest.raises(SystemExit):
        parser.parse_args(words)
