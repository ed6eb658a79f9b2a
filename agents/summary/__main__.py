"""The command line: `python -m agents.summary runs --output summary.html`."""

from pathlib import Path
from typing import Annotated

import tyro

from agents.summary.builder import write_summary
from dynagen_bench.terminal import one_line_errors


def _command(runs: Annotated[Path, tyro.conf.Positional], output: Path = Path("summary.html")) -> Path:
    """One page of the learning curves and results of all runs in a folder, which loads nothing else.

    Args:
        runs: the folder that run folders are in.
        output: the page.
    """
    if not runs.is_dir():
        raise FileNotFoundError(f"no folder {runs}: give the one that run folders are in")
    if not any(runs.glob("*/config.json")):
        raise FileNotFoundError(f"{runs} holds no run folders: give the one that they are in")
    return write_summary(runs, output)


def main(arguments: list[str] | None = None) -> None:
    """Write the page; an error that a user can mend is one line."""
    with one_line_errors(also=(RuntimeError,)):
        print(f"written: {tyro.cli(_command, prog='python -m agents.summary', args=arguments)}")


if __name__ == "__main__":
    main()
