"""Submissions as files: what is written is read again, and what is anything else ends in one line."""

import json
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynagen_bench.evaluation import RandomPolicy, evaluate
from dynagen_bench.evaluation.submission import (
    FILE_NAME,
    MAX_BYTES,
    Run,
    Submission,
    read_submission,
    read_traces,
    schema_text,
    submission_text,
    write_submission,
)
from tests.evaluation.samples import evaluation, submission, traced


def plain(**fields):
    return submission({"Hopper": [80.0, 100.0], "Ant": [60.0]}, **fields)


def test_what_is_written_is_read_again(tmp_path):
    path = write_submission(tmp_path / "new" / "folder", plain(paper="https://arxiv.org/abs/1&x=1", commit="0123abc"))
    assert path == tmp_path / "new" / "folder" / FILE_NAME
    assert os.listdir(path.parent) == [FILE_NAME]
    again = read_submission(path.parent)
    assert again == plain(paper="https://arxiv.org/abs/1&x=1", commit="0123abc")
    assert again.runs[0].evaluation.evaluation().returns.tolist() == evaluation("Hopper", 80.0).returns.tolist()


def test_the_text_is_the_same_bytes_and_plain_json():
    text = submission_text(plain())
    assert text == submission_text(plain())
    assert json.loads(text) == plain().model_dump(mode="json", exclude_defaults=True)
    assert "[80.0, 80.0, 80.0, 80.0, 80.0, 80.0, 80.0, 80.0, 80.0, 80.0]," in text  # a dynamics' episodes on a line


@given(st.text(st.characters(codec="utf-8"), max_size=60))
@settings(max_examples=200, deadline=None)
def test_any_printable_line_survives_as_text(text):
    fine = text.isprintable() and text == text.strip() and text != ""
    try:
        given_submission = plain(description=text)
    except ValueError:
        assert not fine
    else:
        assert fine
        assert Submission.model_validate_json(submission_text(given_submission)) == given_submission


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    write_submission(tmp_path, plain())
    before = (tmp_path / FILE_NAME).read_bytes()
    monkeypatch.setattr(os, "replace", lambda source, target: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_submission(tmp_path, plain(agent="other"))
    assert (tmp_path / FILE_NAME).read_bytes() == before


def edited(**changes):
    """The file's content with fields replaced; a name like `runs__0__seed` goes into the content."""
    content = plain().model_dump(mode="json")
    for name, value in changes.items():
        *path, last = [int(part) if part.isdigit() else part for part in name.split("__")]
        inner = content
        for part in path:
            inner = inner[part]
        inner[last] = value
    return content


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (edited(format_version=3), "format_version: Input should be 1 or 2"),
        (edited(format_version="1"), "format_version: Input should be 1 or 2"),
        (
            edited(commands=["python train.py"]),
            "format_version: 1 has no commands, traces, curves and commits of runs, write 2",
        ),
        (
            edited(runs__1__trace="0" * 64),
            "format_version: 1 has no commands, traces, curves and commits of runs, write 2",
        ),
        (edited(format_version=2, runs__1__trace="../other"), r"runs\.1\.trace: String should match pattern"),
        (edited(format_version=2, commands=["two\nlines"]), r"commands\.0: must be one line"),
        (
            edited(format_version=2, runs__0__curve=[{"gradient_steps": 1, "mean_return": float("nan")}]),
            r"runs\.0\.curve\.0\.mean_return: Input should be a finite number",
        ),
        (edited(agent=""), "agent: String should have at least 1"),
        (edited(agent="x" * 81), "agent: String should have at most 80"),
        (edited(agent="two\nlines"), "agent: must be one line of printable"),
        (edited(agent="right\u202eleft"), "agent: must be one line of printable"),
        (edited(agent=" DADT"), "agent: must be one line of printable"),
        (edited(agent=7), "agent: Input should be a valid string"),
        (edited(authors=[]), "authors: List should have at least 1"),
        (edited(authors=["A", "\x00"]), "authors.1: must be one line of printable"),
        (edited(description="x" * 2001), "description: String should have at most 2000"),
        (edited(code="javascript:alert(1)"), "code: String should match pattern"),
        (edited(code="http://plain.example"), "code: String should match pattern"),
        (edited(paper="https://a.example/)[x](https://b.example"), "paper: String should match pattern"),
        (edited(commit="HEAD"), "commit: String should match pattern"),
        (edited(track="offline"), "track: Input should be 'zero-shot' or 'adaptation'"),
        (edited(checkpoint="first"), "checkpoint: Input should be 'last' or 'best'"),
        (edited(privileged="all"), "privileged: Input should be"),
        (edited(hours=-1.0), "hours: Input should be greater than or equal to 0"),
        (edited(hours=float("nan")), "hours: Input should be a finite number"),
        (edited(versions={"mujoco": "4 0"}), "versions.mujoco: String should match"),
        (edited(versions={"../x": "1"}), "versions.../x.*: String should match"),
        (edited(runs=[]), "runs: List should have at least 1"),
        (edited(runs=plain().model_dump(mode="json")["runs"] * 34), "runs: List should have at most 100"),
        (edited(runs__1__seed=0), "runs 0 and 1 are both Hopper with seed 0"),
        (edited(runs__0__seed=-1), "runs.0.seed: Input should be greater"),
        (edited(runs__0__robot="Ant"), "runs.0: robot is 'Ant', but the evaluation is of 'Hopper'"),
        (edited(runs__0__gradient_steps=10.5), "runs.0.gradient_steps: Input should be a valid integer"),
        (edited(runs__0__score=100.0), "runs.0.score: Extra inputs are not permitted"),
        (
            edited(runs__2__evaluation__returns__4__9=float("inf")),
            "runs.2.evaluation.returns.4.9: Input should be a finite",
        ),
        (edited(runs__2__evaluation__returns__4__9=10**400), "runs.2.evaluation.returns.4.9: Input should be"),
        (edited(runs__2__evaluation__lengths__0__0=0), "runs.2.evaluation.lengths.0.0: Input should be greater"),
        (edited(runs__2__evaluation__returns__1=[1.0]), "runs.2.evaluation: returns: give as many episodes"),
        (edited(traces="traces.npz"), "traces: Input should be null"),
        (edited(extra="<script>"), "extra: Extra inputs are not permitted"),
        ([], "Input should be an object"),
    ],
)
def test_a_wrong_field_is_named_in_one_line(tmp_path, content, message):
    (tmp_path / FILE_NAME).write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        read_submission(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / FILE_NAME}: ")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("field", [name for name, info in Submission.model_fields.items() if info.is_required()])
def test_a_missing_field_is_named(tmp_path, field):
    content = plain().model_dump(mode="json")
    del content[field]
    (tmp_path / FILE_NAME).write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=f"{field}: Field required"):
        read_submission(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "Invalid JSON: EOF"),
        (b"{", "Invalid JSON: EOF"),
        (b"\xff\xfe", "not UTF-8 .* at byte 0"),
        (b"[" * 100_000, "Invalid JSON: recursion limit"),
        (b'{"agent": "\\ud800"}', "Invalid JSON"),
        (b'{"agent": ' + b"9" * 5000 + b"}", "Invalid JSON: number out of range"),
        (b" " * (MAX_BYTES + 1), f"larger than {MAX_BYTES} bytes"),
        (b"\x80\x04N.", "not UTF-8"),  # a pickle
    ],
)
def test_a_broken_file_ends_in_one_line(tmp_path, content, message):
    (tmp_path / FILE_NAME).write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        read_submission(tmp_path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


def test_what_is_no_file_is_not_opened(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"submission\.json is no file"):
        read_submission(tmp_path)
    (tmp_path / "elsewhere").write_text("{}")
    (tmp_path / FILE_NAME).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileNotFoundError, match="is no file"):
        read_submission(tmp_path)
    (tmp_path / FILE_NAME).unlink()
    os.mkfifo(tmp_path / FILE_NAME)
    with pytest.raises(FileNotFoundError, match="is no file"):
        read_submission(tmp_path)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=8,
)


@given(st.data())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_value_in_any_place_is_read_or_refused_in_one_line(tmp_path, data):
    content = plain().model_dump(mode="json")
    inner, key = content, None
    while isinstance(inner, (dict, list)) and inner and (key is None or data.draw(st.booleans())):
        keys = sorted(inner) if isinstance(inner, dict) else range(len(inner))
        parent, key = inner, data.draw(st.sampled_from(keys))
        inner = inner[key]
    parent[key] = data.draw(json_values)
    (tmp_path / FILE_NAME).write_text(json.dumps(content), encoding="utf-8")
    complaint = None
    try:
        read = read_submission(tmp_path)
    except ValueError as error:
        complaint = str(error)
    if complaint is None:
        assert Submission.model_validate_json(submission_text(read)) == read
    else:
        assert complaint.isprintable()


@given(st.binary(max_size=200))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_are_refused_in_one_line(tmp_path, content):
    (tmp_path / FILE_NAME).write_bytes(content)
    with pytest.raises(ValueError, match=r"submission\.json: ") as caught:
        read_submission(tmp_path)
    assert str(caught.value).isprintable()


def test_traces_are_written_beside_and_read_by_the_hash(tmp_path):
    made = traced(tmp_path, seeds=(3, 4))
    assert sorted(p.name for p in tmp_path.rglob("*") if p.is_file()) == [
        "Hopper-seed3.safetensors",
        "Hopper-seed4.safetensors",
        FILE_NAME,
    ]
    for run in made.runs:
        assert read_traces(tmp_path, run).sha256 == run.trace
    first, second = (tmp_path / run.trace_name for run in made.runs)
    first.write_bytes(second.read_bytes())
    with pytest.raises(ValueError, match=r"Hopper-seed3\.safetensors: (its SHA-256 is|larger than)"):
        read_traces(tmp_path, made.runs[0])
    first.unlink()
    with pytest.raises(FileNotFoundError, match=r"Hopper-seed3\.safetensors is no file"):
        read_traces(tmp_path, made.runs[0])


def test_a_trace_that_is_not_given_is_missed_before_anything_is_written(tmp_path):
    made = traced(tmp_path / "mine")
    with pytest.raises(ValueError, match=r"runs\.0\.trace: these traces are not given"):
        write_submission(tmp_path / "other", made)
    assert not (tmp_path / "other").exists()


def test_an_evaluation_is_taken_with_or_without_its_traces():
    found = evaluate(RandomPolicy("Hopper"), "Hopper", episodes=1)
    assert Run.from_evaluation(found, seed=0, gradient_steps=1).trace == found.traces.sha256
    without = evaluate(RandomPolicy("Hopper"), "Hopper", episodes=1, traces=False)
    assert Run.from_evaluation(without, seed=0, gradient_steps=1).trace is None
    assert Run(robot="Hopper", seed=0, gradient_steps=1, evaluation=found).evaluation.evaluation().returns.size == 5


def test_the_first_version_is_read_with_its_null_field(tmp_path):
    content = plain().model_dump(mode="json", exclude_defaults=True) | {"traces": None, "paper": None}
    (tmp_path / FILE_NAME).write_text(json.dumps(content), encoding="utf-8")
    assert read_submission(tmp_path) == plain()
    assert "traces" not in json.loads(submission_text(read_submission(tmp_path)))


def test_the_committed_schema_is_current_and_describes_what_is_written(tmp_path):
    committed = Path(__file__).parents[2] / "docs" / "submission.schema.json"
    assert committed.read_text(encoding="utf-8") == schema_text(), (
        "run `python -m leaderboard schema > docs/submission.schema.json`"
    )
    properties = json.loads(schema_text())["properties"]
    assert json.loads(submission_text(traced(tmp_path))).keys() <= properties.keys()
    assert "traces" not in properties


def test_a_run_without_traces_is_written_and_stays_self_reported(tmp_path):
    result = evaluation()
    assert result.traces is None
    run = Run.from_evaluation(result, seed=0, gradient_steps=0)
    write_submission(tmp_path, submission().model_copy(update={"format_version": 2, "runs": [run]}), [result.traces])
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]
    assert read_submission(tmp_path).runs[0].trace is None
