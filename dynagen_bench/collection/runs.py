"""All SAC runs of a robot: one process a processor, pinned, at low priority.

What is here: which runs are missing, and running them side by side with a progress line each. Called by
`dynagen collect`. It must not know what a run does.
"""

import concurrent.futures
import importlib.util
import multiprocessing
import os
import queue
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import rich.progress

from dynagen_bench import ids
from dynagen_bench.collection.policies import policy_file
from dynagen_bench.collection.settings import SACSettings

NICENESS: Final = 10
"""Runs take hours: they leave the processor to whatever a user does beside them."""

CAN_PIN: Final = hasattr(os, "sched_setaffinity")
"""Only Linux lets a process choose its processor; elsewhere runs share them as the system likes."""


def missing_runs(names: Sequence[ids.DynamicsId], folder: Path) -> list[ids.DynamicsId]:
    """The dynamics that have no stored policies yet."""
    return [name for name in names if not policy_file(name, folder).is_file()]


def collect(names: Sequence[ids.DynamicsId], settings: SACSettings, folder: Path, processes: int | None = None) -> None:
    """Run what is missing of `names`; finished runs are never run again, stopped ones start again.

    Raises:
        RuntimeError: the [collect] extra is not installed, or some runs failed; then the message names them, and the
            others have finished.
    """
    todo = missing_runs(names, folder)
    if not todo:
        return
    if importlib.util.find_spec("sbx") is None:
        raise RuntimeError("training behaviour policies needs more packages: pip install 'dynagen-bench[collect]'")
    cores = (sorted(os.sched_getaffinity(0)) if CAN_PIN else list(range(os.cpu_count() or 1)))[:processes]
    failures = _run_all(todo, settings, folder, cores)
    if failures:
        reasons = "; ".join(f"{label}: {error!r}" for label, error in failures.items())
        raise RuntimeError(f"{len(failures)} runs failed, run the command again to repeat them: {reasons}")


def _run_all(
    todo: Sequence[ids.DynamicsId], settings: SACSettings, folder: Path, cores: Sequence[int]
) -> dict[str, BaseException]:
    """Run each of `todo` in a process of its own, as many at once as there are cores; returns what failed, and why."""
    spawn = multiprocessing.get_context("spawn")
    manager = spawn.Manager()
    reports: queue.Queue[tuple[str, int]] = manager.Queue()
    free_cores: queue.Queue[int] = manager.Queue()
    for core in cores:
        free_cores.put(core)
    columns = (*rich.progress.Progress.get_default_columns(), rich.progress.MofNCompleteColumn())
    failures: dict[str, BaseException] = {}
    with (
        rich.progress.Progress(*columns) as bars,
        concurrent.futures.ProcessPoolExecutor(len(cores), spawn, max_tasks_per_child=1) as pool,
    ):
        whole = bars.add_task("runs", total=len(todo))
        tasks: dict[str, rich.progress.TaskID] = {}
        futures = {pool.submit(_run, name, settings, folder, free_cores, reports): name for name in todo}
        while futures:
            done, _ = concurrent.futures.wait(futures, timeout=1.0, return_when="FIRST_COMPLETED")
            for label, step in _drain(reports):
                if label not in tasks:
                    tasks[label] = bars.add_task(label, total=settings.total_steps)
                bars.update(tasks[label], completed=step)
            for future in done:
                name = futures.pop(future)
                error = future.exception()
                if error is not None:
                    failures[name.env_id] = error
                if name.env_id in tasks:
                    bars.remove_task(tasks.pop(name.env_id))
                bars.advance(whole)
    return failures


def _drain(reports: "queue.Queue[tuple[str, int]]") -> list[tuple[str, int]]:
    found = []
    while not reports.empty():
        found.append(reports.get())
    return found


def _run(name: ids.DynamicsId, settings: SACSettings, folder: Path, free_cores: Any, reports: Any) -> None:
    core = free_cores.get()
    try:
        if CAN_PIN:
            os.sched_setaffinity(0, {core})
        os.nice(NICENESS)
        os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
        os.environ["JAX_PLATFORMS"] = "cpu"
        import torch  # SB3's buffers hold torch tensors; one thread is all that this run has

        from dynagen_bench.collection.sac import train_behaviour_policies

        torch.set_num_threads(1)
        train_behaviour_policies(name, settings, folder, lambda step: reports.put((name.env_id, step)))
    finally:
        free_cores.put(core)
