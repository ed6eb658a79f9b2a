"""What a run has learned, in train dynamics: `python -m agents.evaluate runs/focal-Hopper-seed*`.

What is here: the returns of a finished run's last checkpoint, of the same agent untrained, and of random actions, in
the same episodes of train dynamics. Called from the command line. It must not know any agent by name, nor touch the
test dynamics, whose official result is training's own.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import rich.table
import tyro

from agents.interface import Agent, Fitted
from agents.learner import Learner
from agents.run_folder import LEARNED, write_json
from agents.threads import use_threads
from agents.trained_run import TrainedRun, check_finished
from agents.validation import set_apart
from dynagen_bench import ids
from dynagen_bench.datasets import load_dataset
from dynagen_bench.evaluation import EPISODES, Policy, RandomPolicy, evaluate
from dynagen_bench.terminal import one_line_errors, print_table

COMPARED: Final = ("trained", "untrained", "random")


def measure_learning(folder: Path, dynamics: int | None = None) -> dict[str, Any]:
    """Measure a run, write `evaluation-train.json` in its folder, and return what is in it.

    Args:
        folder: of a finished run of an agent.
        dynamics: measure in the first so many train dynamics; None takes all.

    Raises:
        FileNotFoundError: the folder is no finished run, or the agent needs data that are not here.
        ValueError: the run is of a predictor, or there are not so many dynamics.
    """
    with TrainedRun.held(folder) as run:
        record = _measured(run, dynamics)
        write_json(folder / LEARNED, record)
    return record


def _measured(run: TrainedRun, dynamics: int | None) -> dict[str, Any]:
    robot, seed = run.checkpoint.spec.robot, run.checkpoint.seed
    if dynamics is not None:
        ids.check_count("dynamics", dynamics, most=ids.SPLIT_SIZES["train"])
    names = ids.choose_ids(robot, "train", None if dynamics is None else range(dynamics))
    trained, untrained = run.checkpoint.build_agent(), _untrained(run)
    assert isinstance(trained, Agent), "`TrainedRun` is of agents alone"
    assert isinstance(untrained, Agent), "of the same class"
    policies: Mapping[str, Policy] = dict(
        zip(COMPARED, (trained.policy(), untrained.policy(), RandomPolicy(robot, seed)), strict=True)
    )
    returns = {
        what: evaluate(policy, robot, "train", indices=[name.index for name in names], traces=False, progress=True)
        for what, policy in policies.items()
    }
    return {
        "agent": run.checkpoint.agent,
        "robot": robot,
        "seed": seed,
        "gradient_steps": run.checkpoint.step,
        "episodes": EPISODES,
        "dynamics": [name.label for name in names],
        **{what: evaluation.returns.mean(axis=1).tolist() for what, evaluation in returns.items()},
    }


def _untrained(run: TrainedRun) -> object:
    """The run's agent as it was before its first step, fitted to the data where it has to be."""
    checkpoint, settings = run.checkpoint, run.config["settings"]
    agent = Learner(checkpoint.agent, checkpoint.config, checkpoint.spec, checkpoint.seed).agent
    if isinstance(agent, Fitted):
        data = load_dataset(settings["robot"], "train", every=settings["every"], quality=settings["quality"])
        trained_on, _ = set_apart(data, settings["hold_out"])
        agent.fit(checkpoint.config.sampler(trained_on, checkpoint.spec.normalization))
    return agent


def table(records: Sequence[Mapping[str, Any]]) -> rich.table.Table:
    """A line per run: the mean returns over its dynamics."""
    shown = rich.table.Table("run", "steps", "dynamics", *COMPARED, title="mean return in train dynamics")
    for record in records:
        means = (f"{sum(record[what]) / len(record[what]):.1f}" for what in COMPARED)
        name = f"{record['agent']}, {record['robot']}, seed {record['seed']}"
        shown.add_row(name, f"{record['gradient_steps']:,}", str(len(record["dynamics"])), *means)
    return shown


def _command(
    runs: Annotated[list[Path], tyro.conf.Positional], dynamics: int | None = None, threads: int = 0
) -> rich.table.Table:
    """Compare finished runs with their untrained selves and with random actions, in train dynamics.

    Args:
        runs: run folders that training has finished.
        dynamics: measure in the first so many train dynamics; all of them if left out.
        threads: processor threads for torch; 0 leaves it to torch.
    """
    use_threads(threads)
    check_finished(runs)
    return table([measure_learning(folder, dynamics) for folder in runs])


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    with one_line_errors(
        stopped="the runs that were measured have their results; give the command again for the others"
    ):
        print_table(tyro.cli(_command, prog="python -m agents.evaluate", args=arguments))


if __name__ == "__main__":
    main()
