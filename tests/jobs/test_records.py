"""Half-moved outputs are never taken for done, and never made again."""

import os

import pytest

from dynagen_bench.jobs import Job, changed_outputs
from dynagen_bench.jobs.records import JobFiles

JOB = Job("a", "m:f", {}, ("one.txt", "deep/two.txt"), 1)


@pytest.fixture
def files(tmp_path):
    """The files of a job that has just made its outputs."""
    files = JobFiles(tmp_path, JOB)
    files.begin()
    fill(files)
    return files


def fill(files):
    (files.scratch / "deep").mkdir(exist_ok=True)
    (files.scratch / "one.txt").write_text("1")
    (files.scratch / "deep" / "two.txt").write_text("22")


class Killed(BaseException):
    pass


def finish_and_die(files, monkeypatch, call):
    """`finish`, and die before the `call`-th file gets its name."""
    calls = []
    replace = os.replace

    def dying(source, target):
        if len(calls) == call:
            raise Killed
        calls.append(target)
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr("os.replace", dying)
        with pytest.raises(Killed):
            files.finish({})


@pytest.mark.parametrize("call", [0, 1, 2])
def test_killed_while_it_moves_the_outputs(files, tmp_path, monkeypatch, call):
    finish_and_die(files, monkeypatch, call)
    assert not files.done()
    again = JobFiles(tmp_path, JOB)
    assert again.settle() == (call > 0)  # the record is the first to be replaced: without it the job is not finished
    assert again.done() == (call > 0)
    assert again.scratch.exists() == (call == 0)


def test_old_outputs_of_the_right_size_are_replaced(files, tmp_path, monkeypatch):
    (tmp_path / "one.txt").write_text("0")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "two.txt").write_text("00")
    finish_and_die(files, monkeypatch, 1)
    assert not files.done()
    assert files.settle()
    assert (tmp_path / "deep" / "two.txt").read_text() == "22"


def test_an_old_record_does_not_make_half_an_attempt_done(files, tmp_path):
    files.finish({})
    assert files.done()
    (tmp_path / "one.txt").unlink()
    assert not files.done()
    assert not files.settle()
    files.begin()
    fill(files)  # killed here
    assert not files.done()
    assert not files.settle()


@pytest.mark.parametrize(
    "damage",
    [
        "",
        "{",
        "[]",
        '{"outputs": 3}',
        '{"outputs": {}}',
        '{"outputs": {"one.txt": {}, "deep/two.txt": {}}}',
        '{"outputs": {"one.txt": {"bytes": 1, "sha256": "0"}}}',
    ],
)
def test_a_record_that_cannot_be_read_is_none(files, damage):
    files.finish({})
    files.record.write_text(damage)
    assert files.recorded_outputs() is None
    assert not files.done()
    assert not files.settle()


def test_changed_outputs_are_found_by_their_content(files, tmp_path):
    with pytest.raises(FileNotFoundError, match="has no record of job 'a': run it first"):
        changed_outputs(JOB, tmp_path)
    files.finish({})
    assert changed_outputs(JOB, tmp_path) == []
    (tmp_path / "deep" / "two.txt").write_text("23")
    assert files.done()  # by its size
    assert changed_outputs(JOB, tmp_path) == ["deep/two.txt"]
    (tmp_path / "one.txt").unlink()
    assert changed_outputs(JOB, tmp_path) == ["one.txt", "deep/two.txt"]


def test_one_holds_a_job_at_a_time(tmp_path):
    one, other = JobFiles(tmp_path, JOB), JobFiles(tmp_path, JOB)
    log = one.hold()
    assert other.hold() is None
    log.close()
    other.hold().close()


def test_missing_outputs_and_last_words(files):
    (files.scratch / "one.txt").unlink()
    assert files.missing_outputs() == ["one.txt"]
    for text, words in (("", ""), ("--- start\n", ""), ("--- start\nOops: é\n\n", "Oops: é"), ("x" * 9000, "x" * 4096)):
        files.log.write_text(text)
        assert files.last_words() == words
