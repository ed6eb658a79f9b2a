"""Which return to ask for: `python -m agents.targets runs/dadt-HalfCheetah-seed0-holdout4`.

What is here: what a finished run returns when it is asked for one return and another, in the train dynamics that it
held out. The run is trained once: what is asked for is no part of learning. Called from the command line. It must not
know any agent by name, nor touch the test dynamics: a target is chosen without them.
"""

import dataclasses
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final

import tyro

from agents.fine_tuning import curve_table, write_curve
from agents.interface import Agent
from agents.recording import progress_bar
from agents.run_folder import TARGET_CURVE, made_of, read_json, write_json
from agents.threads import use_threads
from agents.trained_run import TrainedRun, check_finished, held_out_names
from dynagen_bench import ids
from dynagen_bench.datasets.scores import reference_scores
from dynagen_bench.evaluation import evaluate
from dynagen_bench.terminal import one_line_errors, print_table

SHARES: Final = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
"""Of the highest return of an episode in the train data: what is asked for where no targets are given."""


def measure_targets(folder: Path, targets: Sequence[float] = ()) -> dict[float, dict[str, float]]:
    """Measure a run at each target, write `target-curve.csv` in its folder, and return what is in it.

    Args:
        folder: of a finished run of an agent that is asked for a return.
        targets: returns to ask for; none takes `SHARES` of the highest in the train data.

    Returns:
        Target → label of a held-out train dynamics → its mean return over the official episodes.

    Raises:
        FileNotFoundError: the folder is no finished run.
        ValueError: the run is of a predictor or of an agent that is asked for nothing, held out no dynamics, or a
            target is no finite number.
    """
    parts, found = folder / "target-curve", dict[float, dict[str, float]]()
    with TrainedRun.held(folder) as run, progress_bar() as bars:
        names = held_out_names(run)
        if not hasattr(run.checkpoint.config, "target_return"):
            raise ValueError(f"{folder} is of {run.checkpoint.agent!r}, which is asked for no return: it has no target")
        asked = tuple(targets) or usual_targets(run.checkpoint.spec.robot)
        bar = bars.add_task(f"{folder.name}, asking", total=len(asked), note="")
        for target in asked:
            bars.update(bar, note=f"for {target:g}")
            part, facts = parts / f"{target!r}.json", run.facts | {"target_return": target}
            if not made_of(part, facts):
                write_json(part, facts | {"mean_returns": _mean_returns(run, target, names)})
            found[target] = read_json(part)["mean_returns"]
            bars.advance(bar)
        write_curve(folder / TARGET_CURVE, "target_return", [*found], _by_dynamics(found))
        shutil.rmtree(parts)
    return found


def _mean_returns(run: TrainedRun, target: float, names: Sequence[ids.DynamicsId]) -> dict[str, float]:
    """Label of a train dynamics → the run's mean return there when it is asked for `target`."""
    config = dataclasses.replace(run.checkpoint.config, target_return=target)  # type: ignore[call-arg]
    agent = dataclasses.replace(run.checkpoint, config=config).build_agent()
    assert isinstance(agent, Agent), "`TrainedRun` is of agents alone"
    indices, robot = [name.index for name in names], run.checkpoint.spec.robot
    means = evaluate(agent.policy(), robot, "train", indices=indices, traces=False).returns.mean(axis=1)
    return {name.label: float(mean) for name, mean in zip(names, means, strict=True)}


def usual_targets(robot: str) -> tuple[float, ...]:
    """`SHARES` of the highest return of an episode in a robot's train data, in whole numbers."""
    scores = reference_scores(robot)
    best = max(one.max for label, one in scores.items() if label.startswith("train"))
    return tuple(float(round(share * best)) for share in SHARES)


def _by_dynamics(found: Mapping[float, Mapping[str, float]]) -> dict[str, list[float]]:
    """Label of a dynamics → its mean return at each target."""
    labels = next(iter(found.values()))
    return {label: [means[label] for means in found.values()] for label in labels}


def _command(
    runs: Annotated[list[Path], tyro.conf.Positional], targets: tuple[float, ...] = (), threads: int = 0
) -> None:
    """Measure finished runs at several target returns, in the train dynamics that they held out.

    Args:
        runs: folders of finished runs that were trained with --hold-out.
        targets: returns to ask for; a quarter to three halves of the highest in the train data if left out.
        threads: processor threads for torch; 0 leaves it to torch.
    """
    use_threads(threads)
    check_finished(runs)
    for folder in runs:
        found = measure_targets(folder, targets)
        title = f"{folder.name}: return in held-out train dynamics"
        print_table(curve_table("asked for", [*found], _by_dynamics(found), title))


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    with one_line_errors(stopped="give the same command again to continue"):
        tyro.cli(_command, prog="python -m agents.targets", args=arguments)


if __name__ == "__main__":
    main()
