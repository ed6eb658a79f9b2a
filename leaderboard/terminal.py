"""The board's tables in the terminal.

What is here: `show_tables` and `show_comparison`. Called by the command line. It must not compute scores.
"""

import statistics
from collections.abc import Mapping, Sequence

import rich.box
import rich.table
from rich.text import Text

from dynagen_bench import ids
from dynagen_bench.terminal import print_table
from leaderboard.comparison import FEWEST, compared
from leaderboard.entries import Entry
from leaderboard.markdown import iqm_text, number_text, rank_text, score_text
from leaderboard.standings import CHECKPOINTS, TRACKS, Cell, Table, data_scores, standings, task_scores
from leaderboard.statistics import Estimate


def show_tables(entries: Sequence[Entry]) -> None:
    """Print one table a track and checkpoint, of the robots that somebody has a score on."""
    grids = []
    for table in standings(entries):
        robots = [robot for robot in ids.ROBOTS if any(robot in row.cells for row in table.rows)]
        grids.append(_means(table, robots))
        # the last of several has the rank of their number, and one alone has nobody to be ranked with
        if any(cell.rank and cell.rank.worst > 1 for row in table.rows for cell in row.cells.values()):
            grids.append(_ranks(table, robots))
    if not grids:
        print("There are no entries yet.")
    for number, grid in enumerate(grids):
        if number:
            print()
        print_table(grid)


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
    # names are paths, which a column of a narrow terminal would break into pieces
    print(f"first:  {first}\nsecond: {second}\n")
    rows = [standings([entry])[0].rows[0] for entry in (one, other)]
    heads = ("First", "Second", "Probability\n[95 % interval]", "Better")
    grid = _grid("How likely is a run of the first better than one of the second?", "Robot", *heads)
    better = {"holds": "first", "does not hold": "second"}
    for robot in whole.robots:
        alone = compared(robot, {robot: scores[robot]}, others)
        cells = [_stacked(score_text(row.cells[robot]), " (") for row in rows]
        grid.add_row(robot, *cells, _probability(alone.estimate), better.get(alone.verdict, alone.verdict))
    grid.add_section()
    means = [number_text(statistics.fmean(row.cells[robot].mean for robot in whole.robots)) for row in rows]
    grid.add_row("all of these", *means, _probability(whole.estimate), better.get(whole.verdict, whole.verdict))
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
    """Mean and standard deviation, with the behaviour data's own score below."""
    grid = _grid(f"{TRACKS[table.track]}, {CHECKPOINTS[table.checkpoint]}", "Agent", *robots)
    for row in table.rows:
        note = f"partial, {row.entry.label}" if row.partial else row.entry.label
        cells = [_score(row.cells.get(robot)) for robot in robots]
        grid.add_row(_agent(row.entry.submission.agent, note), *cells, end_section=row is table.rows[-1])
    data = data_scores()
    scores = [number_text(data[robot]) if robot in data else "–" for robot in robots]
    grid.add_row(_agent("behaviour data", "reference"), *scores)
    return grid


def _ranks(table: Table, robots: Sequence[str]) -> rich.table.Table:
    """Interquartile mean, interval and rank, robot by robot; over all robots too, where somebody has all."""
    grid = _grid("Interquartile means and ranks", "Robot", "Agent", "Mean", "95 % interval", "Rank")
    grid.columns[1].justify = "left"
    columns = {robot: [(row, row.cells.get(robot)) for row in table.rows] for robot in robots}
    columns["All robots"] = [(row, row.overall) for row in table.rows]
    for column, cells in columns.items():
        known = [(row, cell) for row, cell in cells if cell is not None and cell.iqm.interval is not None]
        grid.add_section()
        for place, (row, cell) in enumerate(sorted(known, key=lambda one: -one[1].iqm.value)):
            mean, interval = iqm_text(cell).split(" ", 1)
            name = Text(row.entry.submission.agent)
            grid.add_row("" if place else column, name, mean, interval, rank_text(cell.rank))
    return grid


def _grid(title: str, first: str, *columns: str) -> rich.table.Table:
    """An empty table, without lines between its columns: so an agent and five robots fit a terminal of 80."""
    box = rich.box.SIMPLE_HEAD
    grid = rich.table.Table(title=title, box=box, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    grid.add_column(first, overflow="fold")  # a narrow terminal breaks words, and cuts none
    for column in columns:
        grid.add_column(column, justify="right", overflow="fold")
    return grid


def _agent(name: str, note: str) -> Text:
    # Text, because a plain string would be read for rich's own markup
    return Text.assemble(name, "\n", (note, "dim"))


def _score(cell: Cell | None) -> Text:
    """Short lines, one under the other: `74.69`, `± 4.22` and, where it is not the full number, `(3 runs)`."""
    return _stacked(score_text(cell), " ±", " (", style="bold" if cell is not None and cell.bold else "")


def _stacked(text: str, *starts: str, style: str = "") -> Text:
    """A text with an end of the line in place of the space that each of its parts starts with."""
    for start in starts:
        text = text.replace(start, f"\n{start.strip()}")
    return Text(text, style=style)
