"""What every command line does alike: tables on standard output, progress and mistakes on the error stream.

What is here: `print_table` and `one_line_errors`, called by the command lines; `track`, called by what takes more than
a moment. It must not know what a table says, nor what is counted.
"""

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from typing import Final, TypeVar

import rich.console
import rich.progress
import rich.table

Item = TypeVar("Item")

UNBOUNDED: Final = 1000
"""Columns of what has no edge, more than any table takes."""

STOPPED: Final = 130
"""Exit status after Ctrl-C, as shells have it."""


def print_table(table: rich.table.Table) -> None:
    """Print a table; in a file or a pipe each line whole, however narrow the terminal is that it was started from."""
    # a console's own `is_terminal` is what FORCE_COLOR says, in a pipe too
    rich.console.Console(width=None if sys.stdout.isatty() else UNBOUNDED).print(table)


def track(items: Iterable[Item], description: str, total: int, show: bool = True) -> Iterator[Item]:
    """Yield the items under a progress bar, which is gone when they end or the caller stops asking."""
    console = rich.console.Console(stderr=True)
    yield from rich.progress.track(items, description, total=total, console=console, transient=True, disable=not show)


@contextlib.contextmanager
def one_line_errors(
    name: str = "error", also: tuple[type[Exception], ...] = (), stopped: str = "give the same command again"
) -> Iterator[None]:
    """Run a command: what a user can mend, and Ctrl-C, end in one line on stderr and not in a traceback.

    Args:
        name: what the line begins with.
        also: errors that a user can mend, besides ValueError and OSError.
        stopped: what Ctrl-C leaves, and how to go on.

    Raises:
        SystemExit: with the line, which is status 1; `STOPPED` after Ctrl-C; 1 and no line where the reader of the
            output has gone, as `| head` does.
    """
    mended: tuple[type[Exception], ...] = (ValueError, OSError, *also)
    try:
        yield
        sys.stdout.flush()  # here, where a reader that has gone is expected
    except BrokenPipeError:  # the rest goes nowhere, also at Python's own last flush
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except mended as error:
        first, _, _ = str(error).partition("\n")  # h5py's go on for hundreds of lines
        sys.exit(f"{name}: {first}")
    except KeyboardInterrupt:
        sys.stderr.write(f"stopped: {stopped}\n")
        sys.exit(STOPPED)
