"""Next-state errors of runs, the paper's Table 3 and Figure 4: `python -m agents.predict runs/dadt-* runs/mlp-*`.

What is here: reading runs, measuring their last checkpoints in the test data, and the table. Called from the command
line. It must not know any agent by name, nor how an error is computed.
"""

import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import rich.table
import tyro

from agents.checkpoint import Checkpoint, load_checkpoint
from agents.interface import Predictor
from agents.prediction import EPISODES, PredictionErrors, prediction_errors
from agents.recording import write_prediction
from agents.run_folder import DATA, locked, read_config
from agents.threads import use_threads
from dynagen_bench import ids
from dynagen_bench.datasets import load_dataset
from dynagen_bench.terminal import one_line_errors, print_table


class Run(NamedTuple):
    """A run to be measured, or one that has been."""

    folder: Path
    checkpoint: Checkpoint
    settings: dict[str, Any]
    """Of `RunSettings`, as JSON types."""

    @property
    def every(self) -> int:
        """The part of the data that it was trained on, one in so many snapshots."""
        return int(self.settings["every"])

    @property
    def cell(self) -> tuple[str, str]:
        """Its agent and robot: the place in the table."""
        return self.checkpoint.agent, self.checkpoint.spec.robot


def predict(
    runs: Annotated[list[Path], tyro.conf.Positional],
    test_every: int | None = None,
    episodes: int | None = EPISODES,
    threads: int = 0,
) -> None:
    """Measure runs in the data of the test dynamics, and show a table.

    Measured as training measures (no `--test-every`, no `--episodes`), the errors are also the run's record,
    `prediction.json` in its folder. Errors are of normalised states, each run's by the part of the data that it was
    trained on: with `--test-every`, runs of several parts are on nearly the same scale, not on the same.

    Args:
        runs: run folders that training has made, of any agents, robots and seeds. Those that cannot predict are named.
        test_every: measure in every n-th snapshot's data alone; the part that the runs were trained on if left out.
        episodes: of each test dynamics at most this many, spread over their returns; None takes all.
        threads: processor threads for torch; 0 leaves it to torch.

    Raises:
        FileNotFoundError: a folder is no run, or the test data are not here.
        ValueError: the runs do not belong in one table, or another process works in one.
    """
    if not runs:
        raise ValueError("no runs given: name at least one run folder")
    use_threads(threads)
    for folder in runs:
        read_run(folder)  # a folder that is no run gets no lock
    measured, unchanged = dict[tuple[str, str], list[float]](), dict[str, float]()
    with contextlib.ExitStack() as held:  # from what is measured to the record of it, nobody trains a run on
        for folder in dict.fromkeys(folder.resolve() for folder in runs):
            held.enter_context(locked(folder))
        found = [read_run(folder) for folder in runs]
        parts = check_comparable(found, test_every)
        for run in found:
            errors = measure(run, parts[run.checkpoint.spec.robot], episodes)
            if errors is None:
                print(f"{run.folder}: {run.checkpoint.agent} does not predict the next state, left out")
            else:
                measured.setdefault(run.cell, []).append(errors.mean)
                unchanged[errors.robot] = float(errors.unchanged.mean())
    if measured:
        print_table(table(measured, unchanged))


def read_run(folder: Path) -> Run:
    """A run's last checkpoint and settings.

    Raises:
        FileNotFoundError: the folder is no run.
        ValueError: its files are not what training writes, or not of one run.
    """
    for file in ("config.json", "last.safetensors"):
        if not (folder / file).is_file():
            raise FileNotFoundError(f"{folder} is no run, it has no {file}: give a folder that training made")
    about = read_config(folder)
    agent, settings = about["agent"], about["settings"]
    return Run(folder, load_checkpoint(folder / "last.safetensors", agent=agent, robot=settings["robot"]), settings)


def check_comparable(runs: Sequence[Run], test_every: int | None) -> dict[str, int]:
    """The part of the test data for each robot.

    Raises:
        ValueError: runs of one agent and robot differ in more than their seed, or in nothing; or runs of one robot in
            what their states are normalised by, or in their part of the data while no part is asked for.
    """
    check_cells(runs)
    parts, first = dict[str, int](), dict[str, Run]()
    for run in runs:
        other = first.setdefault(run.checkpoint.spec.robot, run)
        for setting in ("quality", "hold_out"):
            if run.settings[setting] != other.settings[setting]:
                raise ValueError(
                    f"{setting} of {other.folder} is {other.settings[setting]!r}, of {run.folder} "
                    f"{run.settings[setting]!r}: their states are normalised by other data, so that the errors are on "
                    "two scales, give them apart"
                )
        part = parts.setdefault(run.checkpoint.spec.robot, run.every if test_every is None else test_every)
        if test_every is None and part != run.every:
            raise ValueError(
                f"{run.folder} was trained on every {run.every} of the snapshots, another run of its robot on every "
                f"{part}: give --test-every, so that all are measured in the same data"
            )
    return parts


def check_cells(runs: Sequence[Run]) -> None:
    """Raise ValueError if runs of one agent and robot are not those of a mean: made alike, each of its own seed."""
    first, seeds = dict[tuple[str, str], Run](), dict[tuple[str, str, int], Run]()
    for run in runs:
        other = first.setdefault(run.cell, run)
        facts, others = _facts(run), _facts(other)
        for fact, here in facts.items():
            if here != others[fact]:
                raise ValueError(
                    f"{fact} of {other.folder} is {others[fact]!r}, of {run.folder} {here!r}: a mean over both means "
                    "nothing, give them apart"
                )
        twin = seeds.setdefault((*run.cell, run.checkpoint.seed), run)
        if twin is not run:
            raise ValueError(
                f"{twin.folder} and {run.folder} are both {' for '.join(run.cell)} with seed {run.checkpoint.seed}: "
                "give each run once"
            )


def _facts(run: Run) -> dict[str, Any]:
    """All that the runs of a cell have in common."""
    data = {setting: run.settings[setting] for setting in DATA}
    return {"step": run.checkpoint.step} | dataclasses.asdict(run.checkpoint.config) | data


def measure(run: Run, every: int, episodes: int | None) -> PredictionErrors | None:
    """The errors of a run, written to its folder if measured as training does; None if its agent cannot predict."""
    predictor, spec = run.checkpoint.build_agent(), run.checkpoint.spec
    if not isinstance(predictor, Predictor):
        return None
    test = load_dataset(spec.robot, "test", every=every)
    errors = prediction_errors(predictor, test, spec.normalization, run.checkpoint.config.context, episodes=episodes)
    if (every, episodes) == (run.every, EPISODES):  # the run's own record; what else is asked for is shown alone
        write_prediction(run.folder, run.checkpoint, errors, every, episodes)
    return errors


def table(measured: dict[tuple[str, str], list[float]], unchanged: dict[str, float]) -> rich.table.Table:
    """Errors by (agent, robot): mean ± standard deviation (of a sample) over runs, and how many they are.

    The last line is what a predictor has to beat, by robot: the error of the present state in its place.
    """
    robots = [robot for robot in ids.ROBOTS if any(robot == column for _, column in measured)]
    agents = dict.fromkeys(agent for agent, _ in measured)
    shown = rich.table.Table("agent", *robots, title="mean square error of normalised next states, test dynamics")
    for agent in agents:
        shown.add_row(agent, *(summary(measured.get((agent, robot), [])) for robot in robots))
    shown.add_section()
    shown.add_row("no change", *(f"{unchanged[robot]:.5f}" for robot in robots))
    return shown


def summary(errors: Sequence[float]) -> str:
    """`0.0123 ± 0.0004 (5)`, without a deviation of one run."""
    if not errors:
        return ""
    spread = f" ± {np.std(errors, ddof=1):.5f}" if len(errors) > 1 else ""
    return f"{np.mean(errors):.5f}{spread} ({len(errors)})"


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    left = "the runs that were measured have their results; give the command again for the others"
    with one_line_errors(also=(FloatingPointError,), stopped=left):
        tyro.cli(predict, prog="python -m agents.predict", args=arguments)


if __name__ == "__main__":
    main()
