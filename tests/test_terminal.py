"""Tables that are read by people, and by what stands behind a pipe."""

import os
import pty
import re
import subprocess
import sys

import pytest
import rich.table

from dynagen_bench.terminal import print_table

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
