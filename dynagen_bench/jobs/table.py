"""What is seen of running jobs, on stderr: one line for all, one for each that runs.

What is here: the lines and their columns. Called by the runner. It must not know why something happens.
"""

from types import TracebackType

import rich.console
import rich.markup
import rich.progress
import rich.text

_DAY = 24 * 60 * 60


class _Rate(rich.progress.ProgressColumn):
    """Units a second, or an hour where a second has none."""

    def render(self, task: rich.progress.Task) -> rich.text.Text:
        speed = task.finished_speed or task.speed or 0.0
        text = f"{speed:,.0f}/s" if speed >= 10 else f"{speed:.1f}/s" if speed >= 0.1 else f"{speed * 3600:,.1f}/h"
        return rich.text.Text(text if speed else "", style="progress.data.speed", justify="right")


class Table:
    """The lines; a context, in which they are live on a terminal. Elsewhere only the last state is printed."""

    def __init__(self, jobs: int, done: int) -> None:
        self._bars = rich.progress.Progress(
            rich.progress.TextColumn("{task.description}"),
            rich.progress.BarColumn(),
            rich.progress.TaskProgressColumn(),
            rich.progress.TextColumn("{task.fields[state]}"),
            _Rate(),
            rich.progress.TimeElapsedColumn(),
            rich.progress.TimeRemainingColumn(),
            console=rich.console.Console(stderr=True),
            speed_estimate_period=_DAY,
            refresh_per_second=2,
        )
        self._counts = {"done": done, "running": 0, "failed": 0, "elsewhere": 0}
        self._all = self._bars.add_task("all jobs", total=jobs, completed=done, state=self._state())
        self._lines: dict[str, rich.progress.TaskID] = {}

    def __enter__(self) -> "Table":
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def start(self, name: str, total: int) -> None:
        """A job runs."""
        self._lines[name] = self._bars.add_task(rich.markup.escape(name), total=total, state="")
        self._counts["running"] += 1

    def move(self, name: str, units: int) -> None:
        """A job has come to `units`."""
        line = self._lines[name]
        total = self._bars.tasks[self._bars.task_ids.index(line)].total or 0
        self._bars.update(line, completed=units, state=f"{units:,}/{total:,.0f}")

    def end(self, name: str, state: str) -> None:
        """A job runs no more, and is "done", "failed", or neither: it will be tried again."""
        self._bars.remove_task(self._lines.pop(name))
        self._counts["running"] -= 1
        self.count(state)

    def count(self, state: str) -> None:
        """One job more is "done" or "failed"."""
        if state in self._counts:
            self._counts[state] += 1

    def refresh(self, elsewhere: int) -> None:
        """Bring the line of all up to date; `elsewhere` are at work for another runner."""
        self._counts["elsewhere"] = elsewhere
        running = [self._bars.tasks[self._bars.task_ids.index(line)] for line in self._lines.values()]
        parts = sum(min(1.0, task.completed / (task.total or 1)) for task in running)
        self._bars.update(
            self._all, completed=self._counts["done"] + self._counts["failed"] + parts, state=self._state()
        )

    def _state(self) -> str:
        return ", ".join(f"{n} {state}" for state, n in self._counts.items() if n or state in ("done", "running"))
