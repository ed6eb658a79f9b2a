"""Many runs, each a job: `python -m agents.sweep "{dadt,dt} --robot {Hopper,Walker} --seed {0,1,2} --steps 5000"`.

What is here: running what `sweep_plan` has read, and the page of the curves. Called from the command line; `train_one`
by a job's process. It must not know how a run goes, nor how jobs are run.

What a run is, its resolved config, is part of its job; the command that makes it alone is in its config.json, beside
the one thread that it has here. A sweep that was stopped goes on when the same command is given again.
"""

import contextlib
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from agents import TRAINABLE
from agents.interface import Agent
from agents.run_folder import RunSettings, git_commit, is_committed
from agents.summary import write_summary
from agents.sweep_plan import SweepRun, is_finished, plan
from agents.train import run
from dynagen_bench.datasets import load_dataset
from dynagen_bench.jobs import run_jobs
from dynagen_bench.terminal import one_line_errors

SUMMARY: Final = "summary.html"
"""In the folder of the runs."""


def train_one(
    scratch: Path,
    report: Callable[[int], None],
    agent: str,
    config: Mapping[str, Any],
    settings: Mapping[str, Any],
    command: str,
) -> None:
    """Train one run of a sweep in `scratch`, from its checkpoint if there is one."""
    resolved = RunSettings(**settings, runs=scratch)
    run((agent, TRAINABLE[agent][0](**config), resolved), command, report)


def sweep(lines: Sequence[str], runs: Path, processes: int | None = None, ray: str | None = None) -> list[SweepRun]:
    """Train what is not done of the runs that `lines` stand for, and write the page of all runs in the folder.

    Args:
        lines: command lines of `agents.train` with braces.
        runs: the folder.
        processes: how many at once; None is one per processor.
        ray: None runs them here; "local" or the address of a cluster runs them on Ray, whose nodes need the data.

    Raises:
        ValueError: a line or number that makes no sense, two lines of one run, or a folder that is of another run.
        FileNotFoundError: the data are not here.
        RuntimeError: some failed; then the message names them, and the others have finished. Or a package is missing.
    """
    planned = plan(lines)
    todo = [one for one in planned if not is_finished(one, runs)]
    if ray in (None, "local"):  # its flat arrays are made once, and not by every process
        needed = {(one.settings.robot, "train", one.settings.every) for one in todo}
        # who predicts is measured on test data in the end
        predictors = [one.settings for one in todo if not issubclass(TRAINABLE[one.agent][1], Agent)]
        needed |= {(settings.robot, "test", settings.every) for settings in predictors}
        for robot, split, every in sorted(needed):
            load_dataset(robot, split, every=every)
    try:
        run_jobs([one.job for one in todo], runs, processes=processes, ray=ray)
    except BaseException:  # an interruption too
        with contextlib.suppress(ValueError):  # why it stopped matters more than a page that cannot be made
            write_summary(runs, runs / SUMMARY)
        raise
    write_summary(runs, runs / SUMMARY)
    return planned


def read_lines(jobs_file: Path) -> list[str]:
    """The command lines of a file, but for blank lines and comments (`#`)."""
    if not jobs_file.is_file():
        raise FileNotFoundError(f"no file {jobs_file}: give one with a command line of agents.train on each line")
    lines = (line.strip() for line in jobs_file.read_text(encoding="utf-8").splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def _command(
    lines: Annotated[list[str], tyro.conf.Positional, tyro.conf.arg(metavar="COMMAND")] = [],  # noqa: B006, only read
    jobs_file: Path | None = None,
    runs: Path = Path("runs"),
    processes: int | None = None,
    ray: str | None = None,
) -> str:
    """Train all runs that command lines stand for; what is done is not done again.

    Args:
        lines: each the arguments of `python -m agents.train` in quotes, braces in it expanded as a shell does.
        jobs_file: more of them, one per line; lines that begin with `#` are comments.
        runs: folder of the run folders and of summary.html.
        processes: how many at once; one per processor if left out.
        ray: "local", or the address of a cluster.
    """
    if (commit := git_commit()) and not is_committed(commit):
        warning = "warning: files of the checkout are not as they are committed: nobody can make these runs again"
        print(warning, file=sys.stderr)
    planned = sweep([*lines, *(read_lines(jobs_file) if jobs_file else [])], runs, processes, ray)
    return f"runs in {runs}: {len(planned)}, their curves in {runs / SUMMARY}"


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    with one_line_errors(also=(RuntimeError,), stopped="give the same command again to go on"):
        print(tyro.cli(_command, prog="python -m agents.sweep", args=arguments))


if __name__ == "__main__":
    main()
