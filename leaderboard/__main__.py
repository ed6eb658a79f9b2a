"""The command line: `python -m leaderboard submit DIR`, `build`, `show`."""

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import rich.console
import tyro

from leaderboard import board as boards
from leaderboard.entries import read_entries
from leaderboard.terminal import show_tables


def submit(
    directory: Annotated[Path, tyro.conf.Positional],
    board: Path = boards.BOARD,
    replace: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> None:
    """Check a submission, compute its scores from its returns, add it to the board and make the page anew.

    Args:
        directory: Folder that holds submission.json.
        board: The board's folder, with entries/ and LEADERBOARD.md.
        replace: Take the place of an entry of the same name.
    """
    entry = boards.submit(directory, board, replace)
    print(f"added {entry.slug}; the page is {board / boards.PAGE}")
    here = version("mujoco")
    others = sorted({run.evaluation.mujoco for run in entry.submission.runs} - {here})
    if others:
        print(f"note: evaluated with MuJoCo {', '.join(others)}, here is {here}: returns differ between versions")


def build(board: Path = boards.BOARD, check: tyro.conf.FlagCreatePairsOff[bool] = False) -> None:
    """Make LEADERBOARD.md from the entries.

    Args:
        board: The board's folder, with entries/ and LEADERBOARD.md.
        check: Write nothing; end with status 1 if the page is not what would be written.
    """
    if not check:
        print(f"wrote {boards.build(board)}")
    elif not boards.is_current(board):
        raise ValueError(f"{board / boards.PAGE} is stale: run `python -m leaderboard build`")


def show(board: Path = boards.BOARD) -> None:
    """Print the board's tables in the terminal.

    Args:
        board: The board's folder, with entries/ and LEADERBOARD.md.
    """
    show_tables(read_entries(board), rich.console.Console())


def main(arguments: list[str] | None = None) -> int:
    """Run one command; what is wrong is said in one line on stderr, with status 1."""
    try:
        tyro.extras.subcommand_cli_from_dict(
            {"submit": submit, "build": build, "show": show},
            prog="python -m leaderboard",
            description="The leaderboard: add a submission, make the page, show the tables.",
            args=arguments,
        )
    except (OSError, ValueError) as error:
        print(f"leaderboard: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
