"""Fine-tuning for each test dynamics (the paper, Table 1): `python -m agents.adapt runs/dadt-Hopper-seed0`.

What is here: from a finished run to the official evaluation of five agents, each fine-tuned on ten episodes of the test
dynamics that it acts in; `--curve` tells how many steps to take, by train dynamics that the run held out. Called from
the command line; `submit --track adaptation` takes what it leaves. It must not know any agent by name.

A run that was killed goes on with the dynamics that it was at: give the same command again.
"""

import dataclasses
import shutil
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rich.table
import torch
import tyro

from agents.fine_tuning import (
    CURVE,
    AdaptationSettings,
    FineTuning,
    check_takes_steps,
    curve_table,
    measure_curve,
    write_curve,
)
from agents.recording import progress_bar, read_result, write_result
from agents.run_folder import ADAPTATION_CURVE, commit_of_all, git_commit, made_of, read_json, write_json
from agents.threads import use_threads
from agents.trained_run import TrainedRun, check_finished, held_out_names
from dynagen_bench import ids
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.evaluation.traces import Traces, physics_digest
from dynagen_bench.terminal import one_line_errors, print_table


def adapt(folder: Path, settings: AdaptationSettings) -> Path:
    """Fine-tune and evaluate for each test dynamics, or go on with it; returns the file of the result.

    Raises:
        FileNotFoundError: the folder is no finished run, or the test data are missing.
        ValueError: the run is of a predictor, or of another robot or agent than its folder says.
        FloatingPointError: a loss is no number any more; the dynamics that are done are kept.
    """
    result, parts = folder / "adaptation.json", folder / "adaptation"
    with TrainedRun.held(folder) as run:
        settings = settings.for_agent(run.checkpoint.build_agent(), run.checkpoint.config)
        assert settings.steps is not None, "for_agent fills it in"
        robot, steps = run.checkpoint.spec.robot, run.checkpoint.step + settings.steps
        facts = run.facts | {"adaptation": dataclasses.asdict(settings), "gradient_steps": steps}
        if made_of(result, facts):
            return result
        names = ids.choose_ids(robot, "test")
        files = [parts / f"{name.label}.json" for name in names]
        _adapt_each(run, settings, dict(zip(files, names, strict=True)), {**facts, "physics": physics_digest(robot)})
        made = [read_json(file) for file in files]
        threads = {part.get("threads", 0) for part in made}
        how = {
            "hours": run.record["hours"] + sum(part["hours"] for part in made),
            "commit": commit_of_all([part.get("commit") for part in made]),
            "threads": threads.pop() if len(threads) == 1 else 0,
        }
        write_result(result, {**facts, **how}, join([read_result(file) for file in files]))
        shutil.rmtree(parts)
    return result


def _adapt_each(
    run: TrainedRun, settings: AdaptationSettings, names: Mapping[Path, ids.DynamicsId], facts: dict[str, Any]
) -> None:
    """Make the files that are not there, of `facts`, one per dynamics."""
    data, steps = run.data(list(names.values()), settings.episodes), settings.steps or 0
    with progress_bar() as bars:
        bar = bars.add_task(f"{run.folder.name}, adapting", total=steps * len(names), note="")
        for number, (file, name) in enumerate(names.items()):
            bars.update(bar, completed=number * steps, note=name.label)
            if not made_of(file, facts):
                started, tuning = time.monotonic(), FineTuning(run.checkpoint, settings, name, data[number])
                tuning.advance_to(steps, lambda: bars.advance(bar))
                evaluation = tuning.evaluate()
                how = {"commit": git_commit(), "threads": torch.get_num_threads()}
                write_result(file, {**facts, **how, "hours": (time.monotonic() - started) / 3600}, evaluation)


def join(parts: Sequence[Evaluation]) -> Evaluation:
    """One evaluation of several, each of other dynamics, in this order; all with traces."""
    traces = [part.traces for part in parts if part.traces is not None]
    steps = (np.concatenate([getattr(one, field) for one in traces]) for field in ("lengths", "actions", "states"))
    return dataclasses.replace(
        parts[0],
        indices=tuple(index for part in parts for index in part.indices),
        returns=np.concatenate([part.returns for part in parts]),
        lengths=np.concatenate([part.lengths for part in parts]),
        seeds=np.concatenate([part.seeds for part in parts]),
        traces=Traces(*steps),
    )


def comparison(before: Evaluation, after: Evaluation) -> rich.table.Table:
    """Return and score in each dynamics and in all, without and with fine-tuning."""
    table = rich.table.Table("dynamics", title=f"{before.robot}: mean return (score)")
    for word in ("zero-shot", "adapted"):
        table.add_column(word, justify="right")
    cells = [[*_cells(evaluation)] for evaluation in (before, after)]
    for row in zip((*before.labels, "all"), *cells, strict=True):
        table.add_row(*row)
    return table


def _cells(evaluation: Evaluation) -> list[str]:
    means = [*evaluation.returns.mean(axis=1), evaluation.returns.mean()]
    try:
        scores = [f" ({score:.1f})" for score in (*evaluation.dynamics_scores.values(), evaluation.score)]
    except ValueError:  # no reference scores of this robot are made yet
        scores = [""] * len(means)
    return [f"{mean:.1f}{score}" for mean, score in zip(means, scores, strict=True)]


def choose_steps(folder: Path, settings: AdaptationSettings, points: Sequence[int] = CURVE) -> Path:
    """Measure and print the returns after each number of steps, in held-out train dynamics; returns the CSV file.

    Raises:
        FileNotFoundError, ValueError, FloatingPointError: as `adapt`; or the run held out no dynamics, its agent takes
            no steps, or the settings say how many.
    """
    if settings.steps is not None:
        raise ValueError(f"steps is {settings.steps}, and the curve has a point after each of {points}: leave it out")
    path, parts = folder / ADAPTATION_CURVE, folder / "adaptation-curve"
    with TrainedRun.held(folder) as run, progress_bar() as bars:
        check_takes_steps(run)
        names = held_out_names(run)
        data = run.data(names, settings.episodes)
        facts = run.facts | {"adaptation": dataclasses.asdict(settings) | {"steps": [*points]}}
        bar = bars.add_task(f"{folder.name}, curve", total=max(points) * len(names), note="")
        for number, (name, own) in enumerate(zip(names, data, strict=True)):
            bars.update(bar, completed=number * max(points), note=name.label)
            if not made_of(part := parts / f"{name.label}.json", facts):
                means = measure_curve(run.checkpoint, settings, name, own, points, lambda: bars.advance(bar))
                write_json(part, {**facts, "mean_returns": means})
        returns = {name.label: read_json(parts / f"{name.label}.json")["mean_returns"] for name in names}
        write_curve(path, "steps", points, returns)
        shutil.rmtree(parts)
    print_table(curve_table("steps", points, returns, f"{folder.name}: return in held-out train dynamics"))
    return path


def command(
    runs: Annotated[list[Path], tyro.conf.Positional],
    settings: Annotated[AdaptationSettings, tyro.conf.arg(name="")],
    curve: bool = False,
    threads: int = 0,
) -> None:
    """Fine-tune finished runs for each test dynamics, and evaluate them there.

    Args:
        runs: folders of runs that training has finished.
        settings: how.
        curve: instead, measure the return after each number of steps, in the train dynamics that the runs held out.
        threads: processor threads for torch; 0 leaves it to torch.
    """
    use_threads(threads)
    check_finished(runs)
    for run in runs:
        result = choose_steps(run, settings) if curve else adapt(run, settings)
        if not curve:
            before = Evaluation.from_json(read_json(run / "evaluation.json")["evaluation"])
            print_table(comparison(before, read_result(result)))
        print(f"written: {result}")


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    with one_line_errors(also=(FloatingPointError,), stopped="give the same command again to continue"):
        tyro.cli(command, prog="python -m agents.adapt", args=arguments)


if __name__ == "__main__":
    main()
