"""The board's tables in the terminal.

What is here: `show_tables` and `show_comparison`. Called by the command line. It must not compute scores.
"""

import statistics
from collections.abc import Mapping, Sequence

import rich.table
from rich.text import Text

from dynagen_bench import ids
from dynagen_bench.terminal import print_table
from leaderboard.comparison import FEWEST, compared
from leaderboard.entries import Entry
from leaderboard.markdown import iqm_text, number_text, rank_text, score_text
from leaderboard.standings import CHECKPOINTS, TRACKS, Cell, Row, Table, data_scores, standings, task_scores
from leaderboard.statistics import Estimate


def show_tables(entries: Sequence[Entry]) -> None:
    """Print one table a track and checkpoint, of the robots that somebody has a score on."""
    tables = standings(entries)
    if not tables:
        print("There are no entries yet.")
    for table in tables:
        robots = [robot for robot in ids.ROBOTS if any(robot in row.cells for row in table.rows)]
        print_table(_means(table, robots))
        # the last of several has the rank of their number, and one alone has nobody to be ranked with
        if any(cell.rank and cell.rank.worst > 1 for row in table.rows for cell in row.cells.values()):
            print_table(_ranks(table, robots))


def show_comparison(entries: Mapping[str, Entry]) -> None:
    """Print how two entries score on each robot that both have, and how likely a run of the first is the better one.

    Args:
        entries: two, by the name that each is to be called.

    Raises:
        ValueError: they have no robot in common.
    """
    (first, one), (second, other) = entries.items()
    scores, others = task_scores(one.submission), task_scores(other.submission)
    whole = compared("all", scores, others)
    if not whole.robots:
        raise ValueError(
            f"{first} has runs on {', '.join(scores)} and {second} on {', '.join(others)}: on no robot both"
        )
    rows = [standings([entry])[0].rows[0] for entry in (one, other)]
    grid = rich.table.Table(title=Text(f"How likely is a run of {first} better than one of {second}?"))
    for column in ("Robot", Text(first), Text(second), "Probability [95 % interval]", "Better"):
        grid.add_column(column, justify="right" if column != "Robot" else "left", overflow="fold")
    better = {"holds": first, "does not hold": second}
    for robot in whole.robots:
        alone = compared(robot, {robot: scores[robot]}, others)
        cells = [Text(score_text(row.cells[robot])) for row in rows]
        grid.add_row(robot, *cells, _probability(alone.estimate), Text(better.get(alone.verdict, alone.verdict)))
    grid.add_section()
    means = [number_text(statistics.fmean(row.cells[robot].mean for robot in whole.robots)) for row in rows]
    grid.add_row("all of these", *means, _probability(whole.estimate), Text(better.get(whole.verdict, whole.verdict)))
    print_table(grid)
    unsure = [name for name, entry in entries.items() if not entry.replayed]
    if unsure:
        print(f"Nobody has replayed {' and '.join(unsure)}: there are no traces, and the returns are what was sent in.")
    if min(whole.runs) < FEWEST:
        print(f"Nothing is decided by fewer than {FEWEST} runs of each (docs/statistics.md).")


def _probability(estimate: Estimate | None) -> str:
    if estimate is None or estimate.interval is None:
        return "–" if estimate is None else number_text(estimate.value)
    low, high = estimate.interval
    return f"{number_text(estimate.value)} [{number_text(low)}, {number_text(high)}]"


def _means(table: Table, robots: Sequence[str]) -> rich.table.Table:
    """Mean ± standard deviation, with the behaviour data's own score below."""
    grid = _grid(f"{TRACKS[table.track]}, {CHECKPOINTS[table.checkpoint]}", [*robots])
    grid.add_column("Label", overflow="fold")
    for row in table.rows:
        grid.add_row(*_cells(row, robots), end_section=row is table.rows[-1])
    data = data_scores()
    scores = [number_text(data[robot]) if robot in data else "–" for robot in robots]
    grid.add_row("behaviour data", *scores, "reference", style="dim")
    return grid


def _ranks(table: Table, robots: Sequence[str]) -> rich.table.Table:
    """Interquartile mean and interval, with the rank below; over all robots too, where somebody has all."""
    whole = any(row.overall is not None for row in table.rows)
    grid = _grid("Interquartile mean [95 % interval], rank", [*robots, *(["All robots"] if whole else [])])
    for row in table.rows:
        cells = [*(row.cells.get(robot) for robot in robots), *([row.overall] if whole else [])]
        grid.add_row(Text(row.entry.submission.agent), *(Text(_rank_cell(cell)) for cell in cells))
    return grid


def _rank_cell(cell: Cell | None) -> str:
    """Two short lines, so that six columns fit a terminal: `74.69, rank 1–2` and `[70.10, 78.02]`."""
    if cell is None or cell.iqm.interval is None:
        return "–"
    value, interval = iqm_text(cell).split(" ", 1)
    return f"{value}, rank {rank_text(cell.rank)}\n{interval}" if cell.rank else f"{value}\n{interval}"


def _grid(title: str, columns: Sequence[str]) -> rich.table.Table:
    grid = rich.table.Table(title=title)
    grid.add_column("Agent", overflow="fold")  # a narrow terminal breaks words, and cuts none
    for column in columns:
        grid.add_column(column, justify="right", overflow="fold")
    return grid


def _cells(row: Row, robots: Sequence[str]) -> list[Text]:
    # Text objects, because a plain string would be read for rich's own markup
    agent = Text(row.entry.submission.agent + (" (partial)" if row.partial else ""))
    cells = []
    for robot in robots:
        cell = row.cells.get(robot)
        cells.append(Text(score_text(cell), style="bold" if cell is not None and cell.bold else ""))
    return [agent, *cells, Text(row.entry.label)]
