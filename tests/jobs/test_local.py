"""Jobs on this machine: each once and whole, whoever is killed."""

import collections
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dynagen_bench.jobs import Job, run_jobs
from dynagen_bench.jobs.records import JobFiles
from tests.jobs.work import journal_lines

ROOT = Path(__file__).parents[2]


def surely(condition, seconds=240.0):
    """Wait for something that is bound to happen."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.05)


def alive(pid):
    """Whether a process lives; one that nobody has waited for yet does not."""
    stat = Path(f"/proc/{pid}/stat")
    try:
        return stat.read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def chain(journal, name, steps=3, seconds=0.0):
    """A job that leaves a checkpoint at each of its steps, and notes when it starts, continues and ends."""
    arguments = {"journal": str(journal), "name": name, "steps": steps, "seconds": seconds}
    return Job(name, "tests.jobs.work:digests", arguments, (f"{name}/digest.txt", f"{name}/large.bin"), steps)


def test_each_runs_once_in_any_order_with_the_same_results(tmp_path):
    journal = tmp_path / "journal"
    jobs = [chain(journal, f"job{i}") for i in range(5)]
    shuffled = random.Random(1).sample(jobs, len(jobs))
    first = run_jobs(jobs, tmp_path / "first", processes=3)
    second = run_jobs(shuffled, tmp_path / "second", processes=1)
    assert [outcome.name for outcome in first] == [job.name for job in jobs]
    assert all(outcome.attempts == 1 for outcome in first)
    assert sorted(map(str, first)) == sorted(map(str, second))
    assert collections.Counter(line[0] for line in journal_lines(journal)) == {"start": 10, "end": 10}
    for job in jobs:
        for output in job.outputs:
            assert (tmp_path / "first" / output).read_bytes() == (tmp_path / "second" / output).read_bytes()

    outcomes = run_jobs([*jobs, chain(journal, "more")], tmp_path / "first")  # only what is not done
    assert [outcome.attempts for outcome in outcomes] == [0] * 5 + [1]
    assert outcomes[:5] != first
    assert [outcome.sha256 for outcome in outcomes[:5]] == [outcome.sha256 for outcome in first]
    assert collections.Counter(line[0] for line in journal_lines(journal)) == {"start": 11, "end": 11}
    records = [json.loads(path.read_text()) for path in (tmp_path / "first" / ".jobs").glob("*.json")]
    assert {record["name"] for record in records} == {*(job.name for job in jobs), "more"}
    assert {record["executor"] for record in records} == {"local"}


def test_a_job_has_one_thread_one_processor_low_priority_and_no_stdin(tmp_path):
    run_jobs([Job("a", "tests.jobs.work:surroundings", {}, ("found.json",), 1)], tmp_path)
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["threads"] == "1"
    assert found["stdin"] == ""
    assert found["niceness"] >= 10
    if hasattr(os, "sched_getaffinity"):
        assert len(found["affinity"]) == 1
        assert set(found["affinity"]) <= os.sched_getaffinity(0)
        processors = len(os.sched_getaffinity(0))
        if processors > 1:  # another runner may be at work: it must not be on the same one
            few = Job("b", "tests.jobs.work:surroundings", {}, ("found.json",), 1)
            run_jobs([few], tmp_path / "few", processes=processors - 1)
            found = json.loads((tmp_path / "few" / "found.json").read_text())
            assert len(found["affinity"]) == processors
            assert found["physics_threads"] == 1


def test_a_killed_job_is_tried_again_and_one_that_always_fails_stops_no_other(tmp_path):
    jobs = [
        Job("broken", "tests.jobs.work:broken", {}, ("broken.txt",), 1),
        Job("lazy", "tests.jobs.work:lazy", {}, ("lazy.txt",), 1),
        Job("nowhere", "tests.jobs.no_such_module:f", {}, ("nowhere.txt",), 1),
        Job("killed", "tests.jobs.work:killed_once", {}, ("out.txt",), 1),
        chain(tmp_path / "journal", "well"),
    ]
    with pytest.raises(RuntimeError, match=r"^3 of 5 jobs failed, run the same again to repeat them: ") as caught:
        run_jobs(jobs, tmp_path, processes=2)
    message = str(caught.value)
    assert "\n" not in message
    log = JobFiles(tmp_path, jobs[0]).log
    assert f"broken: exit code 1 (ValueError: the worst), see {log}" in message
    assert "lazy: it ended well and left no lazy.txt" in message
    assert "nowhere: exit code 1 (ModuleNotFoundError: No module named 'tests.jobs.no_such_module')" in message
    assert log.read_text().count("before the worst") == 2
    assert (tmp_path / "out.txt").read_text() == "whole"
    assert "--- killed by signal 9" in JobFiles(tmp_path, jobs[3]).log.read_text()
    outcomes = run_jobs(jobs[3:], tmp_path)
    assert [outcome.attempts for outcome in outcomes] == [0, 0]
    assert not (tmp_path / "broken.txt").exists()


RUN = """
import signal, sys
from pathlib import Path
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background commands inherit that it is ignored
from dynagen_bench.jobs import run_jobs
from tests.jobs.test_local import chain
folder = Path(sys.argv[1])
jobs = [chain(folder / "journal", f"job{{i}}", {steps}, {seconds}) for i in range({count})]
run_jobs(jobs, folder, processes=2, ray={ray!r})
"""


@contextlib.contextmanager
def runner(folder, **what):
    """A runner of its own in another process, killed with its group if it still lives when the block ends."""
    folder.mkdir(exist_ok=True)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", RUN.format(**{"ray": None} | what), str(folder)],
        start_new_session=True,
        env=environment,
        stderr=subprocess.PIPE,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_killed_runner_leaves_nobody_at_work_and_the_next_continues(tmp_path, how):
    journal = tmp_path / "journal"
    with runner(tmp_path, count=2, steps=10**6, seconds=0.01) as process:
        surely(lambda: len(list((tmp_path / ".jobs").glob("*/checkpoint.json"))) == 2)
        process.send_signal(how)
        assert process.wait(timeout=120) != 0
    pids = [int(line[2]) for line in journal_lines(journal) if line[0] == "start"]
    assert len(pids) == 2
    surely(lambda: not any(map(alive, pids)))

    jobs = [chain(journal, f"job{i}", 10**6, 0.01) for i in range(2)]
    for job in jobs:  # as if they were nearly done
        (JobFiles(tmp_path, job).scratch / "checkpoint.json").write_text(f'[{10**6 - 1}, "{job.name}"]')
    outcomes = run_jobs(jobs, tmp_path, processes=2)
    assert [outcome.attempts for outcome in outcomes] == [1, 1]
    assert sum(line[0] == "continue" for line in journal_lines(journal)) == 2


def test_two_runners_at_once_run_each_job_once(tmp_path):
    with (
        runner(tmp_path, count=6, steps=4, seconds=0.1) as one,
        runner(tmp_path, count=6, steps=4, seconds=0.1) as other,
    ):
        assert (one.wait(timeout=240), other.wait(timeout=240)) == (0, 0)
    starts = [line[1] for line in journal_lines(tmp_path / "journal") if line[0] == "start"]
    assert sorted(starts) == [f"job{i}" for i in range(6)]
    assert all(JobFiles(tmp_path, chain(tmp_path / "journal", f"job{i}", 4, 0.1)).done() for i in range(6))
