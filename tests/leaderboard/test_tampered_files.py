"""Files that are meant to do harm: they cost no memory, run nothing, and lead nowhere out of their folder."""

import json
import os
import pickle
import tracemalloc
import zipfile

import numpy as np
import pytest

from leaderboard.__main__ import main
from leaderboard.board import PAGE, submit
from tests.evaluation.samples import traced
from tests.leaderboard.cheats import TRACE


def huge_array(cheat):
    header = json.dumps({"actions": {"dtype": "F32", "shape": [10**9, 3], "data_offsets": [0, 12 * 10**9]}}).encode()
    cheat.write_trace(len(header).to_bytes(8, "little") + header)


def huge_file(cheat):
    with (cheat.folder / TRACE).open("r+b") as file:
        file.truncate(10**12)


def zip_bomb(cheat):
    path = cheat.folder / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("actions.npy", bytes(10**7))
    cheat.write_trace(path.read_bytes())


class Exploit:
    def __reduce__(self) -> tuple:
        return os.system, ("touch executed",)


def pickled(cheat):
    cheat.write_trace(pickle.dumps(Exploit()))


def numpy_pickled(cheat):
    np.save(cheat.folder / "objects.npy", np.array([Exploit()]), allow_pickle=True)
    cheat.write_trace((cheat.folder / "objects.npy").read_bytes())


def linked(cheat):
    target = cheat.folder.parent / "secret"
    target.write_bytes((cheat.folder / TRACE).read_bytes())
    (cheat.folder / TRACE).unlink()
    (cheat.folder / TRACE).symlink_to(target)


def linked_folder(cheat):
    (cheat.folder / "traces").rename(cheat.folder.parent / "elsewhere")
    (cheat.folder / "traces").symlink_to(cheat.folder.parent / "elsewhere")


def pipe(cheat):
    (cheat.folder / TRACE).unlink()
    os.mkfifo(cheat.folder / TRACE)


HOSTILE = [huge_array, huge_file, zip_bomb, pickled, numpy_pickled, linked, linked_folder, pipe]


@pytest.mark.parametrize("change", HOSTILE)
def test_hostile_files_cost_no_memory_and_run_nothing(cheat, capsys, monkeypatch, change):
    monkeypatch.chdir(cheat.folder.parent)
    main(["verify", str(cheat.folder)])  # what is made once and kept
    change(cheat)
    capsys.readouterr()
    before = sorted(cheat.folder.parent.rglob("*"))
    tracemalloc.start()
    try:
        assert main(["verify", str(cheat.folder)]) == 2
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"leaderboard: {cheat.folder / TRACE}")
    assert line.isprintable()
    assert sorted(cheat.folder.parent.rglob("*")) == before  # nothing was written, nothing executed


def test_markup_in_every_text_is_text(tmp_path, board, capsys):
    bad = '<script>alert(1)</script><img src=x onerror="alert(2)">'
    traced(
        tmp_path / "mine", agent=bad, authors=[bad], description=bad, hardware=bad, commands=[bad + " [red]{{ 7 * 7 }}"]
    )
    submit(tmp_path / "mine", board)
    text = (board / PAGE).read_text(encoding="utf-8")
    assert "<script" not in text
    assert "<img" not in text
    assert main(["verify", "--all", "--board", str(board)]) == 0
    assert [path.name for path in sorted(board.parent.iterdir())] == ["board", "mine", "references"]
