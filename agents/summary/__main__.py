"""The command line: `python -m agents.summary runs --output summary.html`."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from agents.summary.builder import write_summary


def _command(runs: Annotated[Path, tyro.conf.Positional], output: Path = Path("summary.html")) -> Path:
    """One page of the learning curves and results of all runs in a folder, which loads nothing else.

    Args:
        runs: the folder that run folders are in.
        output: the page.
    """
    if not runs.is_dir():
        raise FileNotFoundError(f"no folder {runs}: give the one that run folders are in")
    return write_summary(runs, output)


def main(arguments: list[str] | None = None) -> None:
    """Write the page; an error that a user can mend is one line."""
    try:
        print(f"written: {tyro.cli(_command, prog='python -m agents.summary', args=arguments)}")
    except (ValueError, OSError, RuntimeError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
