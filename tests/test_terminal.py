"""Tables that are read by people, and by what stands behind a pipe."""

import os
import pty
import re
import subprocess
import sys

import pytest
import rich.table

from dynagen_bench.terminal import one_line_errors, print_table, track

LONG = ["dynagen/SlimHumanoid-RandDyn/train10-every4-v0", "official"]
PROGRAM = f"""
import rich.table
from dynagen_bench.terminal import print_table
table = rich.table.Table("dataset", "content")
table.columns[0].overflow = "fold"
table.add_row(*{LONG})
print_table(table)
"""


def test_in_a_pipe_each_line_is_whole(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setenv("FORCE_COLOR", "1")  # as CI services do
    table = rich.table.Table("dataset", "content")
    table.add_row(*LONG)
    print_table(table)
    assert f"{LONG[0]} │ {LONG[1]}" in capsys.readouterr().out


def test_in_a_terminal_it_keeps_within_the_edge() -> None:
    ours, theirs = pty.openpty()
    environment = os.environ | {"COLUMNS": "30", "TERM": "xterm"}
    subprocess.run([sys.executable, "-c", PROGRAM], stdout=theirs, env=environment, check=True)
    os.close(theirs)
    printed = re.sub(r"\x1b\[[0-9;]*m", "", os.read(ours, 65536).decode())
    os.close(ours)
    cells = [line.split("│")[1].strip() for line in printed.splitlines() if "│" in line]
    assert "".join(cells) == LONG[0]
    assert max(map(len, printed.splitlines())) <= 30


def test_what_is_counted_is_passed_on_under_a_bar_on_the_error_stream(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # else a bar that is gone in the end is not shown at all
    assert list(track(iter("abc"), "letters", 3)) == ["a", "b", "c"]
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "letters" in shown.err
    assert list(track("abc", "letters", 3, show=False)) == ["a", "b", "c"]
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("error", [ValueError, OSError, FileNotFoundError, KeyError, RuntimeError])
def test_a_mistake_is_its_first_line(error: type[Exception]) -> None:
    message = "Can't write data (no space left)\n  #000: H5D.c\n"  # h5py's go on
    mended = error in (ValueError, OSError, FileNotFoundError)
    expected = SystemExit if mended else error
    with pytest.raises(expected) as ended, one_line_errors("dynagen"):
        raise error(message)
    if mended:
        assert ended.value.args == (
            "dynagen: Can't write data (no space left)",
        )  # which Python writes, and ends with 1
    with pytest.raises(SystemExit, match=r"\Aerror: "), one_line_errors(also=(RuntimeError, KeyError)):
        raise error(message)


def test_after_ctrl_c_it_is_said_how_to_go_on(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match=r"^130$"), one_line_errors(stopped="the first of them are done"):
        raise KeyboardInterrupt
    assert capsys.readouterr().err == "stopped: the first of them are done\n"


@pytest.mark.parametrize("lines", [1, 100_000])
def test_a_reader_that_goes_away_is_no_mistake(lines: int) -> None:
    code = f"from dynagen_bench.terminal import one_line_errors\nwith one_line_errors():\n print('x\\n' * {lines})"
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as gone:
        ended = subprocess.run([sys.executable, "-c", code], stdout=gone, stderr=subprocess.PIPE, check=False)
    assert (ended.returncode, ended.stderr) == (1, b"")
