"""What a verification found, as a table in the terminal.

What is here: `checks_table`. Called by the command line. It must not verify anything.
"""

import dataclasses
from collections.abc import Sequence

import rich.table
from rich.text import Text

from leaderboard.verify import RunCheck


def checks_table(name: str, checks: Sequence[RunCheck]) -> rich.table.Table:
    """A line per run of one submission: what was replayed, its official score, the result, seconds."""
    # Text objects, because a plain string would be read for rich's own markup
    table = rich.table.Table(title=Text(name))
    table.add_column("Robot")
    for header in ("Run", "Episodes", "Transitions", "Score"):
        table.add_column(header, justify="right")
    table.add_column("Result")
    table.add_column("Seconds", justify="right")
    for check in checks:
        faults = len(check.faults)
        result = f"{faults} fault{'s' * (faults != 1)}" if faults else check.label
        table.add_row(
            check.run.robot,
            str(check.run.seed),
            str(check.returns.size),
            f"{check.transitions:,}",
            _score(check),
            Text(result, style="bold red" if faults else ""),
            f"{check.seconds:.1f}",
        )
    return table


def _score(check: RunCheck) -> str:
    """The score of the replayed returns; `–` where there are none, or no reference scores yet."""
    if check.faults:
        return "–"
    try:
        return f"{dataclasses.replace(check.run.evaluation.evaluation(), returns=check.returns).score:.2f}"
    except ValueError:
        return "–"
