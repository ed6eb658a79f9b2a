"""The board's tables in the terminal.

What is here: `show_tables`. Called by the command line. It must not compute scores.
"""

from collections.abc import Sequence

import rich.console
import rich.table
from rich.text import Text

from dynagen_bench import ids
from leaderboard.entries import Entry
from leaderboard.markdown import LABEL, number_text, score_text
from leaderboard.standings import CHECKPOINTS, TRACKS, Row, data_scores, standings


def show_tables(entries: Sequence[Entry], console: rich.console.Console) -> None:
    """Print one table a track and checkpoint, of the robots that somebody has a score on."""
    tables = standings(entries)
    if not tables:
        console.print("There are no entries yet.")
    for table in tables:
        robots = [robot for robot in ids.ROBOTS if any(robot in row.cells for row in table.rows)]
        grid = rich.table.Table(title=f"{TRACKS[table.track]}, {CHECKPOINTS[table.checkpoint]}")
        grid.add_column("Agent")
        for robot in robots:
            grid.add_column(robot, justify="right")
        grid.add_column("Label")
        for row in table.rows:
            grid.add_row(*_cells(row, robots), end_section=row is table.rows[-1])
        data = data_scores()
        scores = [number_text(data[robot]) if robot in data else "–" for robot in robots]
        grid.add_row("behaviour data", *scores, "reference", style="dim")
        console.print(grid)


def _cells(row: Row, robots: Sequence[str]) -> list[Text]:
    # Text objects, because a plain string would be read for rich's own markup
    agent = Text(row.entry.submission.agent + (" (partial)" if row.partial else ""))
    cells = []
    for robot in robots:
        cell = row.cells.get(robot)
        cells.append(Text(score_text(cell), style="bold" if cell is not None and cell.bold else ""))
    return [agent, *cells, Text(LABEL)]
