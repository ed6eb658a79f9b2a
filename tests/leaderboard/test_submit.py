"""Submitting: two at once lose none, a kill leaves the board whole, and what was re-run is labelled so."""

import hashlib
import multiprocessing
import os
import signal

import pytest
import safetensors.numpy

from dynagen_bench.datasets import scores
from dynagen_bench.evaluation.submission import FILE_NAME, write_submission
from leaderboard import board as boards
from leaderboard.__main__ import main
from leaderboard.board import PAGE, build, is_current, rerun, submit
from leaderboard.entries import VERDICT, read_entries
from leaderboard.site.builder import SITE
from tests.evaluation.samples import submission, traced
from tests.leaderboard.cheats import TRACE

FORK = multiprocessing.get_context("fork")


def test_an_entry_has_its_traces_and_its_label(tmp_path, board):
    made = traced(tmp_path / "mine", seeds=(0, 1))
    (tmp_path / "mine" / "traces" / "other.bin").write_bytes(b"not copied")
    entry = submit(tmp_path / "mine", board)
    place = board / "entries" / entry.slug
    assert entry.label == "replayed"
    assert entry.submission == made
    assert read_entries(board) == [entry]
    files = sorted(str(path.relative_to(place)) for path in place.rglob("*") if path.is_file())
    assert files == [FILE_NAME, *(run.trace_name for run in made.runs), VERDICT]
    for run in made.runs:
        assert (place / run.trace_name).read_bytes() == (tmp_path / "mine" / run.trace_name).read_bytes()


def test_a_run_without_traces_makes_the_whole_entry_self_reported(tmp_path, board):
    made = traced(tmp_path / "mine", seeds=(0, 1))
    runs = [made.runs[0], made.runs[1].model_copy(update={"trace": None})]
    (tmp_path / "mine" / FILE_NAME).write_text(made.model_copy(update={"runs": runs}).model_dump_json())
    assert submit(tmp_path / "mine", board).label == "self-reported"


def test_one_run_under_two_seeds_is_one_run(tmp_path, board):
    made = traced(tmp_path / "mine")
    runs = [made.runs[0], made.runs[0].model_copy(update={"seed": 1})]
    (tmp_path / "mine" / FILE_NAME).write_text(made.model_copy(update={"runs": runs}).model_dump_json())
    with pytest.raises(ValueError, match=r"runs 0 and 1 have the same trace, they are one run: give it once"):
        submit(tmp_path / "mine", board)


def test_a_comment_in_its_file_makes_no_other_run(cheat, board):
    content = (cheat.folder / TRACE).read_bytes()
    arrays = safetensors.numpy.load(content)
    commented = safetensors.numpy.save(arrays, metadata={"run": "1"})
    (cheat.folder / "traces" / "Hopper-seed1.safetensors").write_bytes(commented)
    run = cheat.content["runs"][0]
    cheat.content["runs"].append(run | {"seed": 1, "trace": hashlib.sha256(commented).hexdigest()})
    cheat.write_trace(content)
    with pytest.raises(
        ValueError, match=r"seed 1: 100% of its episodes .* the same agent's with seed 0: give a run once"
    ):
        submit(cheat.folder, board)


def test_one_episode_that_is_anothers_makes_no_other_run(honest, cheat, board, capsys):
    submit(honest, board)
    cheat.content["agent"] = "another"
    cheat.stand_still(7)
    cheat.write()
    assert main(["verify", str(cheat.folder)]) == 0  # its actions do give its returns
    capsys.readouterr()
    with pytest.raises(ValueError, match=r"with seed 0: 98% of its episodes are those of the entry '"):
        submit(cheat.folder, board)


@pytest.mark.parametrize(
    ("fields", "slug"),
    [
        ({"agent": "mine", "authors": ["Mallory"]}, "mine-zero-shot-last"),
        ({"authors": ["Mallory"], "checkpoint": "best"}, "dadt-zero-shot-best"),
        ({"track": "adaptation"}, "dadt-adaptation-last"),
    ],
)
def test_an_entrys_runs_are_in_no_other_entry(tmp_path, board, fields, slug):
    """Runs that were fine-tuned in the test bodies would else be a zero-shot entry, of whoever sends them."""
    traced(tmp_path / "mine")
    submit(tmp_path / "mine", board)
    traced(tmp_path / "other", **fields)
    with pytest.raises(ValueError, match="100% of its episodes are those of the entry 'dadt-zero-shot-last'"):
        submit(tmp_path / "other", board)
    assert not (board / "entries" / slug).exists()
    traced(tmp_path / "best", checkpoint="best")
    submit(tmp_path / "best", board)  # but an agent's last checkpoint may be its best
    assert [len(checks) for checks in boards.verify_entries(board).values()] == [1, 1]


def test_an_agents_name_is_mended_by_replacing_its_entry(tmp_path, board):
    traced(tmp_path / "mine", agent="my agent")
    slug = submit(tmp_path / "mine", board).slug
    traced(tmp_path / "mended", agent="My-Agent")
    assert submit(tmp_path / "mended", board, replace=True).slug == slug
    assert [entry.submission.agent for entry in read_entries(board)] == ["My-Agent"]


@pytest.mark.parametrize("broken", ['{"label": "replayed", "submission": "' + "0" * 64 + '"}', '{"label": "best"}'])
def test_a_broken_label_is_mended_as_its_message_says(tmp_path, board, monkeypatch, capsys, broken):
    traced(tmp_path / "mine", seeds=(0,))
    entry = submit(tmp_path / "mine", board)
    pages = (board / PAGE).read_bytes()
    place = board / "entries" / entry.slug
    (place / VERDICT).write_text(broken)
    traced(tmp_path / "more", seeds=(1,))
    write_submission(tmp_path / "other", submission(agent="other"))
    command = rf"submit {place} with --replace, which verifies it anew$"
    with monkeypatch.context() as patch:
        patch.setattr(boards, "verify", None)  # it is said before the replay of minutes
        for folder, join in (("other", False), ("more", True)):
            with pytest.raises(ValueError, match=command):
                submit(tmp_path / folder, board, join=join)
    assert main(["verify", "--all", "--board", str(board)]) == 2
    assert command[:-1] in capsys.readouterr().err
    assert main(["submit", str(place), "--replace", "--board", str(board)]) == 0
    assert read_entries(board) == [entry]
    assert (board / PAGE).read_bytes() == pages
    (place / VERDICT).write_text(broken)
    assert submit(tmp_path / "more", board, replace=True).submission.runs[0].seed == 1
    assert [one.label for one in read_entries(board)] == ["replayed"]


def test_an_agent_takes_no_place_of_one_whose_name_has_the_same_letters(tmp_path, board):
    traced(tmp_path / "dt", agent="DT")
    submit(tmp_path / "dt", board)
    traced(tmp_path / "dt-plus", apart=5, agent="DT+")
    for replace in (False, True):
        with pytest.raises(FileExistsError, match=r"has an entry 'dt-zero-shot-last'.* another name"):
            submit(tmp_path / "dt-plus", board, replace=replace)
    assert [entry.submission.agent for entry in read_entries(board)] == ["DT"]


def test_runs_that_were_made_later_join_the_entry(tmp_path, board):
    first = traced(tmp_path / "first", seeds=(0, 1), commit="a" * 40, hours=1.0, commands=["one"])
    submit(tmp_path / "first", board)
    later = traced(tmp_path / "later", ("Hopper",), seeds=(2,), commit="b" * 40, hours=2.0, commands=["one", "two"])
    entry = submit(tmp_path / "later", board, join=True)
    assert entry.label == "replayed"
    assert read_entries(board) == [entry]
    assert [(run.seed, run.commit) for run in entry.submission.runs] == [(0, "a" * 40), (1, "a" * 40), (2, "b" * 40)]
    assert (entry.submission.commit, entry.submission.hours) == (None, 3.0)
    assert entry.submission.commands == ["one", "two"]
    assert entry.submission.runs[2].evaluation == later.runs[0].evaluation
    for made, run in ((first, first.runs[0]), (later, later.runs[0])):
        stored = board / "entries" / entry.slug / run.trace_name
        assert hashlib.sha256(stored.read_bytes()).hexdigest() == made.runs[0].trace
    assert main(["verify", "--all", "--board", str(board)]) == 0
    assert all(commit in (board / PAGE).read_text(encoding="utf-8") for commit in ("a" * 40, "b" * 40))


A, NONE = "a" * 40, None


@pytest.mark.parametrize(("entrys", "laters"), [(A, NONE), (NONE, A), (A, A), (NONE, NONE)])
def test_a_run_of_untold_code_is_not_said_to_be_of_anothers(tmp_path, board, entrys, laters):
    traced(tmp_path / "first", seeds=(0,), commit=entrys)
    submit(tmp_path / "first", board)
    traced(tmp_path / "later", seeds=(1,), commit=laters)
    whole = submit(tmp_path / "later", board, join=True).submission
    assert [run.commit or whole.commit for run in whole.runs] == [entrys, laters]
    line = next(line for line in (board / PAGE).read_text(encoding="utf-8").splitlines() if "- Commit: " in line)
    told = {0: f"- Commit: {A}", 1: f"- Commit: {A}; not given of 1 runs", 2: "- Commit: not given"}
    assert line == told[[entrys, laters].count(NONE)]
    assert ("; not given of 1 runs" in (board / SITE).read_text(encoding="utf-8")) == (entrys != laters)


def test_other_seeds_and_threads_are_the_same_training(tmp_path, board):
    train, adapt = "train --robot Hopper{} --steps 5", "adapt runs/dadt-Hopper-seed{}"
    first = [train.format(""), adapt.format(0)]  # seed 0 is the default, and is not told
    traced(tmp_path / "first", seeds=(0,), commands=first)
    submit(tmp_path / "first", board)
    later = [train.format(" --seed 12 --threads 1"), adapt.format("12 --threads 1")]
    traced(tmp_path / "later", seeds=(12,), commands=later)
    assert submit(tmp_path / "later", board, join=True).submission.commands == first + later


def test_a_folder_that_had_other_runs_before_joins_what_it_has_now(tmp_path, board):
    traced(tmp_path / "first", seeds=(0,))
    slug = submit(tmp_path / "first", board).slug
    traced(tmp_path / "later", seeds=(0,), agent="another", apart=7)  # leaves its traces there
    traced(tmp_path / "later", seeds=(1,))
    submit(tmp_path / "later", board, join=True)
    stored = board / "entries" / slug / "traces" / "Hopper-seed0.safetensors"
    assert stored.read_bytes() == (tmp_path / "first" / "traces" / "Hopper-seed0.safetensors").read_bytes()


def test_runs_with_traces_join_an_entry_of_the_first_format(tmp_path, board):
    write_submission(tmp_path / "first", submission())
    submit(tmp_path / "first", board)
    traced(tmp_path / "later", seeds=(5,))
    with pytest.raises(ValueError, match="it has 0 gradient steps, the entry's on Hopper have 1000: train it as long"):
        submit(tmp_path / "later", board, join=True)
    traced(tmp_path / "later", ("HalfCheetah",), seeds=(5,))
    entry = submit(tmp_path / "later", board, join=True)
    assert (entry.submission.format_version, entry.label) == (2, "self-reported")
    assert read_entries(board) == [entry]


@pytest.mark.parametrize(
    ("seeds", "fields", "message"),
    [
        (
            (2,),
            {"commands": ["train --robot Hopper --seed 2 --context 5"]},
            r"differ in more than the seed, 'train --robot Hopper --context 5' is not on both sides",
        ),
        ((2,), {"commands": [f"command {number}" for number in range(200)]}, "with the entry's runs, commands: "),
        ((1,), {}, r"runs\.0: the entry has a run of Hopper with seed 1: leave it out, or replace the entry"),
        (
            (2,),
            {"description": "More steps."},
            r"description: it is 'More steps\.', the entry has '.*', and it is said once of all runs: mend",
        ),
        ((2,), {"agent": "nobody"}, "has no entry 'nobody-zero-shot-last': did you mean 'dadt-zero-shot-last'?"),
    ],
)
def test_what_does_not_belong_to_an_entry_does_not_join_it(tmp_path, board, seeds, fields, message):
    traced(tmp_path / "first", seeds=(1,), commands=["train --robot Hopper --seed 1"])
    submit(tmp_path / "first", board)
    before = (board / PAGE).read_bytes()
    traced(tmp_path / "later", seeds=seeds, **fields)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        submit(tmp_path / "later", board, join=True)
    assert (board / PAGE).read_bytes() == before


def test_the_episodes_of_another_agent_are_refused(tmp_path, board, capsys):
    traced(tmp_path / "first", agent="first")
    submit(tmp_path / "first", board)
    traced(tmp_path / "copied", agent="copied")
    with pytest.raises(
        ValueError, match=r"with seed 0: 100% of its episodes are those of the entry 'first-zero-shot-last'"
    ):
        submit(tmp_path / "copied", board)
    traced(tmp_path / "best", agent="first", checkpoint="best")  # its last checkpoint may be its best
    submit(tmp_path / "best", board)
    place = board / "entries" / "copied-zero-shot-last"
    (tmp_path / "copied").rename(place)  # as a pull request could bring it
    assert main(["verify", "--all", "--board", str(board)]) == 2
    assert "of its episodes are those of the entry 'first-" in capsys.readouterr().err


@pytest.mark.parametrize(("own", "copied"), [(24, True), (25, False)])
def test_a_run_is_anothers_where_more_than_half_of_its_episodes_are(honest, cheat, board, own, copied):
    submit(honest, board)
    cheat.content["agent"] = "another"
    for episode in range(own):
        cheat.stand_still(episode)
    cheat.write()
    if copied:
        with pytest.raises(ValueError, match=r"with seed 0: 52% of its episodes are those of the entry '"):
            submit(cheat.folder, board)
    else:
        assert submit(cheat.folder, board).label == "replayed"


def test_data_of_the_test_dynamics_are_adaptation(tmp_path, board):
    traced(tmp_path / "mine", privileged="offline-context")
    with pytest.raises(ValueError, match=r"track: 'zero-shot' takes no data of the test dynamics.*'adaptation'"):
        submit(tmp_path / "mine", board)


def test_what_does_not_replay_leaves_the_board_alone(tmp_path, board):
    write_submission(tmp_path / "first", submission())
    submit(tmp_path / "first", board)
    before = {path: path.read_bytes() for path in board.rglob("*") if path.is_file()}
    made = traced(tmp_path / "mine", agent="other")
    content = (tmp_path / "mine" / FILE_NAME).read_text(encoding="utf-8")
    first = str(made.runs[0].evaluation.returns[0][0])
    (tmp_path / "mine" / FILE_NAME).write_text(content.replace(first, "999.0", 1), encoding="utf-8")
    with pytest.raises(ValueError, match=r"returns\.0\.0: 999\.0 is claimed, the replay returns"):
        submit(tmp_path / "mine", board)
    assert {path: path.read_bytes() for path in board.rglob("*") if path.is_file()} == before


def submit_one(references, folder, board, start):
    scores.REFERENCE_FILE = references
    start.wait()
    submit(folder, board)


def test_of_submits_at_the_same_time_none_is_lost(tmp_path, board, references):
    names = [f"agent {number}" for number in range(6)]
    for name in names:
        write_submission(tmp_path / name, submission(agent=name))
    start = FORK.Barrier(len(names))
    processes = [FORK.Process(target=submit_one, args=(references, tmp_path / n, board, start)) for n in names]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
    assert [process.exitcode for process in processes] == [0] * len(names)
    assert sorted(entry.submission.agent for entry in read_entries(board)) == names
    assert is_current(board)


def killed_at(call, references, folder, board):
    """Submit, and be killed by the kernel at the call-th time that something is renamed."""
    scores.REFERENCE_FILE = references
    calls, replace = [], os.replace

    def counting(source, target):
        if len(calls) == call:
            os.kill(os.getpid(), signal.SIGKILL)
        calls.append(target)
        replace(source, target)

    os.replace = counting
    submit(folder, board, replace=True)


@pytest.mark.parametrize("call", range(6))
def test_a_kill_at_any_rename_leaves_the_old_entry_or_the_new_one(tmp_path, board, references, call):
    write_submission(tmp_path / "old", submission({"Hopper": [80.0]}))
    submit(tmp_path / "old", board)
    made = traced(tmp_path / "new")
    process = FORK.Process(target=killed_at, args=(call, references, tmp_path / "new", board))
    process.start()
    process.join(60)
    assert process.exitcode == -signal.SIGKILL
    build(board)  # what the next command does
    (entry,) = read_entries(board)
    assert entry.submission == (made if call == 5 else submission({"Hopper": [80.0]}))
    assert is_current(board)
    assert not [path.name for path in (board / "entries").iterdir() if path.name != entry.slug]
    submit(tmp_path / "new", board, replace=True)
    assert read_entries(board)[0].label == "replayed"


def test_what_maintainers_ran_again_is_labelled_so(tmp_path, board, capsys):
    traced(tmp_path / "mine", seeds=(0, 1))
    slug = submit(tmp_path / "mine", board).slug
    traced(tmp_path / "own", seeds=(1, 0), agent="ours")
    assert main(["rerun", slug, str(tmp_path / "own"), "--board", str(board)]) == 0
    assert capsys.readouterr().out == f"{slug} is labelled re-run\n"
    (entry,) = read_entries(board)
    assert entry.label == "re-run"
    assert is_current(board)
    assert main(["verify", "--all", "--board", str(board)]) == 0


def test_what_was_not_run_again_is_not(tmp_path, board):
    traced(tmp_path / "mine", seeds=(0, 1))
    slug = submit(tmp_path / "mine", board).slug
    made = traced(tmp_path / "own", seeds=(0,))
    with pytest.raises(ValueError, match="the run of Hopper with seed 1 is missing"):
        rerun(slug, tmp_path / "own", board)
    other = traced(tmp_path / "other", seeds=(2,)).runs[0].model_copy(update={"seed": 0})
    (tmp_path / "own" / FILE_NAME).write_text(made.model_copy(update={"runs": [other]}).model_dump_json())
    with pytest.raises(ValueError, match="the run of Hopper with seed 0 did something else"):
        rerun(slug, tmp_path / "own", board)
    with pytest.raises(FileNotFoundError, match="has no entry 'nobody'"):
        rerun("nobody", tmp_path / "own", board)
    with pytest.raises(FileNotFoundError, match="is no folder: give the folder of a board"):
        rerun(slug, tmp_path / "own", tmp_path / "bord")
    assert not (tmp_path / "bord").exists()
    write_submission(tmp_path / "first", submission(agent="first"))
    with pytest.raises(ValueError, match="is self-reported: only what was replayed exactly"):
        rerun(submit(tmp_path / "first", board).slug, tmp_path / "own", board)
    assert [entry.label for entry in read_entries(board)] == ["replayed", "self-reported"]
    assert (board / PAGE).is_file()
    assert boards.is_current(board)
