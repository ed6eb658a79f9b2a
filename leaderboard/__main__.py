"""The command line, `python -m leaderboard`: submit, verify, show, compare, export, rerun, build and schema."""

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import rich.console
import rich.progress
import tyro

from dynagen_bench.evaluation.submission import schema_text
from dynagen_bench.terminal import one_line_errors, print_table
from leaderboard import board as boards
from leaderboard.entries import read_entries, read_official
from leaderboard.export import latex, scores_csv
from leaderboard.terminal import show_comparison, show_tables
from leaderboard.verify import RunCheck
from leaderboard.verify import verify as verify_submission
from leaderboard.verify_table import checks_table


def submit(
    directory: Annotated[Path, tyro.conf.Positional],
    board: Path = boards.BOARD,
    replace: tyro.conf.FlagCreatePairsOff[bool] = False,
    join: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> None:
    """Verify a submission by replay, add it to the board and make the page anew: all of it or nothing.

    Args:
        directory: Folder that holds submission.json and traces/.
        board: The board's folder, with entries/ and LEADERBOARD.md.
        replace: Take the place of an entry of the same name.
        join: Add the runs, of other robots or seeds, to those of the entry of the same name.
    """
    with _progress() as done:
        entry = boards.submit(directory, board, replace, join, done)
    print(f"added {entry.slug}, {entry.label}; the page is {board / boards.PAGE}")


def verify(
    directory: Annotated[Path | None, tyro.conf.Positional] = None,
    every: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(name="all")] = False,
    board: Path = boards.BOARD,
) -> int:
    """Step every episode of a submission again and compare: status 0 if all is as it says, else 2 and a line a fault.

    Args:
        directory: Folder that holds submission.json and traces/.
        every: Instead, verify every entry of the board.
        board: The board's folder.
    """
    try:
        if (directory is None) != every:
            raise ValueError("give either the folder of a submission, or --all")
        with _progress() as done:
            if directory is None:
                found: Mapping[str, Sequence[RunCheck]] = boards.verify_entries(board, done)
            else:
                found = {str(directory): verify_submission(directory, read_official(directory), done)}
    except (OSError, ValueError) as error:
        print(f"leaderboard: {error}", file=sys.stderr)
        return 2
    for name, checks in found.items():
        print_table(checks_table(name, checks))
    faults = [fault for checks in found.values() for check in checks for fault in check.faults]
    for fault in faults:
        print(f"leaderboard: {fault}", file=sys.stderr)
    return 2 if faults else 0


def rerun(
    slug: Annotated[str, tyro.conf.Positional],
    directory: Annotated[Path, tyro.conf.Positional],
    board: Path = boards.BOARD,
) -> None:
    """For maintainers: label an entry re-run, if your own runs of its policy did the same in every episode.

    Args:
        slug: The entry's name.
        directory: Folder of the submission that your runs gave.
        board: The board's folder.
    """
    print(f"{boards.rerun(slug, directory, board).slug} is labelled re-run")


def build(board: Path = boards.BOARD, check: tyro.conf.FlagCreatePairsOff[bool] = False) -> None:
    """Make LEADERBOARD.md and site/index.html from the entries.

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
    show_tables(read_entries(board))


def compare(
    first: Annotated[str, tyro.conf.Positional],
    second: Annotated[str, tyro.conf.Positional],
    board: Path = boards.BOARD,
) -> None:
    """Print how likely a run of the first is better than one of the second, on each robot, and how sure that is.

    Args:
        first: The name of an entry, as dadt-zero-shot-last, or the folder of a submission, which is verified first.
        second: Another.
        board: The board's folder, with entries/ in it.
    """
    if first == second:
        raise ValueError(f"both are {first}: give two entries, or folders of submissions")
    with _progress() as done:
        entries = {name: boards.entry_of(name, board, done) for name in (first, second)}
    show_comparison(entries)


def export(form: tyro.conf.Positional[Literal["csv", "latex"]], board: Path = boards.BOARD) -> None:
    """Write the board's scores to standard output: `python -m leaderboard export csv > scores.csv`.

    Args:
        form: The scores of each run in each dynamics as csv, or the tables as latex.
        board: The board's folder, with entries/ in it.
    """
    entries = read_entries(board)
    sys.stdout.write(scores_csv(entries) if form == "csv" else latex(entries))


def schema() -> None:
    """Print the JSON Schema of submission.json, which is docs/submission.schema.json."""
    sys.stdout.write(schema_text())


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[RunCheck], None]]:
    """A line on stderr that counts the runs and episodes verified; gone when it ends."""
    columns = (rich.progress.SpinnerColumn(), "{task.description}", rich.progress.TimeElapsedColumn())
    console = rich.console.Console(stderr=True)
    with rich.progress.Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("replaying", total=None)
        seen: list[RunCheck] = []

        def done(check: RunCheck) -> None:
            seen.append(check)
            steps = sum(one.transitions for one in seen)
            bar.update(task, description=f"replayed {len(seen)} runs, {steps:,} transitions")

        yield done


def main(arguments: list[str] | None = None) -> int:
    """Run one command; what is wrong is said in one line on stderr, with status 1, or 2 of `verify`."""
    commands: dict[str, Callable[..., int | None]] = {
        "submit": submit,
        "verify": verify,
        "show": show,
        "compare": compare,
        "export": export,
        "rerun": rerun,
        "build": build,
        "schema": schema,
    }
    with one_line_errors("leaderboard", also=(RuntimeError,), stopped="the board is as it was"):
        status = tyro.extras.subcommand_cli_from_dict(
            commands,
            prog="python -m leaderboard",
            description="The leaderboard: verify and add submissions, make the page, show, compare, export.",
            args=arguments,
        )
    return status if isinstance(status, int) else 0


if __name__ == "__main__":
    sys.exit(main())
