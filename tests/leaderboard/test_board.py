"""Submitting and building: all or nothing, the same bytes each time, and one line for what is wrong."""

import json
import os
import re
import subprocess
import sys

import pytest

from dynagen_bench import ids
from dynagen_bench.datasets import scores
from dynagen_bench.evaluation.submission import FILE_NAME, write_submission
from leaderboard.__main__ import main
from leaderboard.board import BOARD, PAGE, build, is_current, submit
from leaderboard.entries import read_entries, slug_of
from leaderboard.site.builder import SITE
from tests.evaluation.samples import evaluation, submission, write_references


def contents(folder):
    """Every file under a folder, but the lock: its path and bytes."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.suffix != ".lock"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture
def folder(tmp_path):
    """A folder with a good submission."""
    write_submission(tmp_path / "mine", submission({"Hopper": [80.0, 120.0]}))
    return tmp_path / "mine"


def test_a_submission_is_copied_and_the_page_made(folder, board):
    (folder / "large.bin").write_bytes(b"not copied")
    entry = submit(folder, board)
    assert entry.slug == "dadt-zero-shot-last"
    assert list(contents(board)) == [PAGE, f"entries/{entry.slug}/{FILE_NAME}", SITE]
    assert read_entries(board) == [entry]
    assert "| 50.00 ± 14.14 (2 runs) |" in (board / PAGE).read_text(encoding="utf-8")
    assert is_current(board)


def test_what_is_stored_is_what_was_understood(folder, board):
    content = json.loads((folder / FILE_NAME).read_text(encoding="utf-8"))
    (folder / FILE_NAME).write_text(json.dumps(dict(reversed(content.items()))), encoding="utf-8")
    before = contents(board.parent)[f"mine/{FILE_NAME}"]
    entry = submit(folder, board)
    stored = contents(board)[f"entries/{entry.slug}/{FILE_NAME}"]
    assert stored != before
    assert json.loads(stored) == json.loads(before)


def test_an_entry_is_replaced_only_when_asked(folder, board, tmp_path):
    submit(folder, board)
    before = contents(board)
    write_submission(tmp_path / "other", submission({"Hopper": [200.0]}))
    with pytest.raises(FileExistsError, match="has an entry 'dadt-zero-shot-last': give --replace"):
        submit(tmp_path / "other", board)
    assert contents(board) == before
    submit(tmp_path / "other", board, replace=True)
    assert "| 100.00 (1 run) |" in (board / PAGE).read_text(encoding="utf-8")
    assert len(read_entries(board)) == 1


def test_the_bytes_do_not_depend_on_the_order_of_submitting(tmp_path):
    names = ["one", "two", "three"]
    for name in names:
        write_submission(tmp_path / name, submission({"Hopper": [80.0, 100.0]}, agent=name))
    for board, order in (("first", names), ("second", names[::-1])):
        for name in order:
            submit(tmp_path / name, tmp_path / board)
    assert contents(tmp_path / "first") == contents(tmp_path / "second")
    build(tmp_path / "second")
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


@pytest.mark.parametrize("replace", [False, True])
@pytest.mark.parametrize("failing", range(5))
@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_an_interrupted_submit_leaves_the_board_as_it_was(
    folder, board, tmp_path, monkeypatch, replace, failing, error
):
    submit(folder, board)
    before = contents(board)
    write_submission(tmp_path / "other", submission(agent="DADT" if replace else "Other"))
    calls = []

    def interrupted(move):
        def moving(source, target):
            calls.append(target)
            if len(calls) == failing + 1:
                raise error
            move(source, target)

        return moving

    for name in ("replace", "rename"):
        monkeypatch.setattr(os, name, interrupted(getattr(os, name)))
    moves = 5 if replace else 4  # the entry's file, an old folder away, the new one in, two pages
    if failing < moves:
        with pytest.raises(type(error)):
            submit(tmp_path / "other", board, replace)
        assert contents(board) == before
    submit(tmp_path / "other", board, replace)
    assert len(read_entries(board)) == (1 if replace else 2)
    assert is_current(board)


def test_what_a_kill_left_behind_is_passed_over(folder, board):
    submit(folder, board)
    killed = board / "entries" / ".other-zero-shot-last.unfinished"
    killed.mkdir()
    (killed / FILE_NAME).write_text("half")
    assert len(read_entries(board)) == 1
    assert is_current(board)
    build(board)
    assert not killed.exists()


def test_a_changed_entry_or_page_or_scale_is_stale(folder, board, references):
    submit(folder, board)
    page = (board / PAGE).read_bytes()
    (board / PAGE).write_bytes(page.replace(b"50.00", b"99.00"))
    assert not is_current(board)
    build(board)
    assert (board / PAGE).read_bytes() == page
    write_references(references)  # now with Walker
    assert not is_current(board)
    build(board)
    assert is_current(board)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"split": "train"}, r"runs\.0\.evaluation\.split: it is 'train', the board takes 'test'"),
        ({"indices": [4, 1, 2, 3, 0]}, r"runs\.0\.evaluation\.indices: they are \[4, 1, 2, 3, 0\]"),
        (evaluation(episodes=3).to_json(), r"runs\.0\.evaluation\.returns: 3 episodes in each dynamics"),
        ({"seeds": [[7] * 10] * 5}, r"runs\.0\.evaluation\.seeds: they are not the official reset seeds"),
    ],
)
def test_only_the_official_protocol_is_taken(tmp_path, board, change, message):
    content = submission().model_dump(mode="json")
    content["runs"][0]["evaluation"].update(change)
    (tmp_path / FILE_NAME).write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        submit(tmp_path, board)
    assert not board.exists()


def test_a_submission_without_reference_scores_is_refused(tmp_path, board):
    write_submission(tmp_path, submission({"Walker": [1.0]}))
    with pytest.raises(ValueError, match="no reference scores for Walker"):
        submit(tmp_path, board)
    assert not board.exists()


def test_an_entry_in_the_wrong_folder_is_named(folder, board):
    entry = submit(folder, board)
    (board / "entries" / entry.slug).rename(board / "entries" / "moved")
    with pytest.raises(ValueError, match=r"moved/submission\.json: belongs into the folder 'dadt-zero-shot-last'"):
        build(board)
    (board / "entries" / "moved" / FILE_NAME).unlink()
    with pytest.raises(FileNotFoundError, match=r"moved/submission\.json is no file"):
        build(board)


@pytest.mark.parametrize(
    ("agent", "slug"),
    [
        ("DADT", "dadt-zero-shot-last"),
        ("Décision  Transformer+ (v2.1)", "decision-transformer-v2-1-zero-shot-last"),
        ("../../etc", "etc-zero-shot-last"),
        ("方策", "a9b29ac979c7-zero-shot-last"),
        ("ﷺ" * 80, None),
    ],
)
def test_slugs_are_safe_names_of_folders(agent, slug):
    made = slug_of(submission(agent=agent))
    assert set(made) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")
    assert 0 < len(made) < 120
    assert slug is None or made == slug


def test_commands(folder, board, capsys):
    assert main(["submit", str(folder), "--board", str(board)]) == 0
    assert "added dadt-zero-shot-last, self-reported; the page is" in capsys.readouterr().out
    assert main(["build", "--board", str(board), "--check"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main(["show", "--board", str(board)]) == 0
    assert re.search(r"^DADT +50\.00\npartial, self-reported +± 14\.14\n +\(2 runs\)$", capsys.readouterr().out, re.M)
    (board / PAGE).write_text("old")
    with pytest.raises(SystemExit) as stop:
        main(["build", "--board", str(board), "--check"])
    assert stop.value.code == f"leaderboard: {board / PAGE} is stale: run `python -m leaderboard build`"
    assert (board / PAGE).read_text() == "old"
    assert main(["build", "--board", str(board)]) == 0
    assert main(["build", "--board", str(board), "--check"]) == 0


def test_wrong_commands_end_in_one_line(folder, board, tmp_path):
    for arguments in (
        ["show", "--board", str(board)],
        ["submit", str(tmp_path / "nothing"), "--board", str(board)],
        ["build", "--check", "--board", str(board)],
    ):
        with pytest.raises(SystemExit, match=r"\Aleaderboard: [^\n]+\Z"):
            main(arguments)
    assert not board.exists()


def test_texts_are_not_read_as_markup_of_the_terminal(tmp_path, board, capsys):
    write_submission(tmp_path, submission(agent="[red]not red[/red] [/]"))
    assert main(["submit", str(tmp_path), "--board", str(board)]) == 0
    capsys.readouterr()
    assert main(["show", "--board", str(board)]) == 0
    assert "[red]not" in capsys.readouterr().out


def test_a_narrow_terminal_cuts_and_breaks_no_word(tmp_path, board, capsys, monkeypatch):
    write_references(scores.REFERENCE_FILE)
    runs = {robot: [100.0, 101.0] for robot in ids.ROBOTS}
    write_submission(tmp_path, submission(runs, agent="trajectory_transformer"))
    assert main(["submit", str(tmp_path), "--board", str(board)]) == 0
    capsys.readouterr()
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")  # 80 columns, no colours
    assert main(["show", "--board", str(board)]) == 0
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    words = shown.split()
    for word in ("trajectory_transformer", "self-reported", *ids.ROBOTS, "50.25"):
        assert word in words


def test_the_leaderboard_loads_no_agent_and_no_torch():
    code = "import leaderboard.__main__, sys; print([m for m in ('torch', 'jax', 'agents') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=BOARD.parent)
    assert run.stdout == "[]\n"


def test_the_committed_board_is_current(monkeypatch):
    monkeypatch.undo()  # the real reference scores
    assert scores.REFERENCE_FILE.parent == BOARD.parent / "dynagen_bench" / "datasets"
    assert is_current(), "run `python -m leaderboard build`"
