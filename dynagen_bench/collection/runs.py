"""All SAC runs of a robot, each a job of its own.

What is here: which runs are missing, and each as a job. Called by `dynagen collect`; `run_one` by a job's process. It
must not know what a run does, nor how jobs run.
"""

import dataclasses
import importlib.util
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dynagen_bench import ids
from dynagen_bench.collection.policies import load_policies, policy_file
from dynagen_bench.collection.settings import SACSettings
from dynagen_bench.jobs import Job, run_jobs


def missing_runs(names: Sequence[ids.DynamicsId], folder: Path) -> list[ids.DynamicsId]:
    """The dynamics that have no stored policies yet."""
    return [name for name in names if not policy_file(name, folder).is_file()]


def collect(
    names: Sequence[ids.DynamicsId],
    settings: SACSettings,
    folder: Path,
    processes: int | None = None,
    ray: str | None = None,
) -> None:
    """Run what is missing of `names`; finished runs are never run again, stopped ones start again.

    Args:
        names: the dynamics.
        settings: what SAC is trained with.
        folder: of the policies, `{robot}/{label}.safetensors`.
        processes: how many at once; None is one per processor.
        ray: None runs them here; "local" or the address of a cluster runs them on Ray.

    Raises:
        ValueError: `processes` makes no sense, one of `names` is of a nominal robot, or `folder` has a run of other
            settings.
        RuntimeError: the [collect] extra is not installed, or some runs failed; then the message names them, and the
            others have finished.
    """
    if any(name.split == "nominal" for name in names):
        raise ValueError("no data are made in the nominal robots: write train0 to train19, test0 to test4")
    todo = missing_runs(names, folder)
    for name in names:
        if name not in todo:
            _check_settings(policy_file(name, folder), settings)
    if not todo:
        return
    if importlib.util.find_spec("sbx") is None:
        raise RuntimeError("training behaviour policies needs more packages: pip install 'dynagen-bench[collect]'")
    run_jobs([run_job(name, settings) for name in todo], folder, processes=processes, ray=ray)


def _check_settings(file: Path, settings: SACSettings) -> None:
    """Raise ValueError if a stored run is of other settings, or is none: it would be taken for one of these."""
    try:
        # a setting that is newer than the run had its default
        stored = dataclasses.asdict(SACSettings()) | load_policies(file)[1]["settings"]
    except (ValueError, KeyError, TypeError) as error:
        said = str(error).splitlines()[0]
        raise ValueError(f"{file} is no finished run ({said}): remove it, and give the same command again") from error
    wanted = dataclasses.asdict(settings)
    changed = [f"{field}={stored.get(field)}" for field, value in wanted.items() if stored.get(field) != value]
    if changed:
        raise ValueError(f"{file} was trained with {', '.join(changed)}: give another --folder for other settings")


def run_job(name: ids.DynamicsId, settings: SACSettings) -> Job:
    """The run of one dynamics. The policies come after the learning curve: where they are, the run is complete."""
    policies = policy_file(name, Path())
    return Job(
        name=name.env_id,
        function=f"{__name__}:run_one",
        arguments={"robot": name.robot, "label": name.label, "settings": dataclasses.asdict(settings)},
        outputs=(policies.with_suffix(".csv").as_posix(), policies.as_posix()),
        total=settings.total_steps,
    )


def run_one(scratch: Path, report: Callable[[int], None], robot: str, label: str, settings: Mapping[str, Any]) -> None:
    """Train the policies of one dynamics; they and their learning curve are left in `scratch`."""
    from dynagen_bench.collection.sac import train_behaviour_policies  # here: SAC's libraries are an extra

    train_behaviour_policies(ids.parse_label(robot, label), SACSettings(**settings), scratch, report)
