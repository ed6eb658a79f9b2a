"""A finished run → the stored weights of its agent and robot: `python -m agents.store runs/dadt-Hopper-seed0`.

What is here: the command line. It must not know what a file holds.
"""

from pathlib import Path
from typing import Annotated

import tyro

from agents.pretrained import read_about, store_run
from dynagen_bench.terminal import one_line_errors


def _command(run: Annotated[Path, tyro.conf.Positional], replace: bool = False) -> str:
    """Store a finished run's weights in agents/pretrained, where `agents.load(AGENT, ROBOT)` finds them.

    Args:
        run: its folder.
        replace: take the place of weights that are stored already.
    """
    path = store_run(run, replace)
    about = read_about(path)
    score = "" if about["score"] is None else f", score {about['score']:.2f}"
    return f"stored: {path}, mean return {about['mean_return']:.1f} in the test dynamics{score}"


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    with one_line_errors():
        print(tyro.cli(_command, prog="python -m agents.store", args=arguments))


if __name__ == "__main__":
    main()
