"""A table on standard output, the one way that every command prints one.

What is here: `print_table`. Called by the command lines. It must not know what a table says.
"""

import sys
from typing import Final

import rich.console
import rich.table

UNBOUNDED: Final = 1000
"""Columns of what has no edge, more than any table takes."""


def print_table(table: rich.table.Table) -> None:
    """Print a table; in a file or a pipe each line whole, however narrow the terminal is that it was started from."""
    # a console's own `is_terminal` is what FORCE_COLOR says, in a pipe too
    rich.console.Console(width=None if sys.stdout.isatty() else UNBOUNDED).print(table)
