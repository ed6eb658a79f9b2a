"""The board as a Markdown page.

What is here: `page`, the escaping of every text that came with an entry, and how a number is written. Called by
`board`; by the site, the terminal's tables, `export` and the reference results for the texts. It must not compute
scores.
"""

from collections.abc import Sequence
from typing import Final

from dynagen_bench import ids
from dynagen_bench.envs import HORIZON
from dynagen_bench.evaluation import EPISODES
from dynagen_bench.markdown import table
from leaderboard.entries import Entry
from leaderboard.standings import (
    CHECKPOINTS,
    RUNS,
    TRACKS,
    Cell,
    Row,
    Table,
    data_scores,
    dynamics_scores,
    standings,
)
from leaderboard.statistics import Rank

INTRODUCTION: Final = f"""\
# Leaderboard

Made by `python -m leaderboard build` from the entries beside it; changes by hand are lost.

A score is 100 · (mean return − min) / (max − min): {EPISODES} episodes of up to {HORIZON} steps in each test dynamics
of a robot, min and max over the returns of those dynamics' data. Given is the mean over runs ± their sample standard
deviation; **bold** is within one standard deviation of the best of its column. A full entry has {RUNS} runs on each
of the {len(ids.ROBOTS)} robots, others are marked *partial*. Every number is computed from the returns of the entry's
episodes: *self-reported* were only sent in, *replayed* were found by stepping every episode again from its trace, and
of *re-run* the maintainers have run the policy itself. The behaviour data were collected in the test dynamics
themselves: a reference, and no entry.

Entries stand in the order of their sum over robots, to which a robot without runs adds nothing.

Where an entry has two runs or more, a second table gives the interquartile mean of the scores of its runs in each
dynamics, a 95 % interval (stratified bootstrap over runs) and its rank. Entries whose intervals overlap share ranks:
the rank is a range, from one more than the entries whose interval lies wholly above, to all but those wholly below.
What knew the test dynamics themselves is a reference too: it is neither bold nor ranked. Nor is what is self-reported.
"""

_ENTITIES: Final = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
_ESCAPED: Final = frozenset("\\`*_{}[]#+.!|~:@^$=")


def escape(text: str) -> str:
    """Text as it stands, for use inside a line of Markdown: no markup, no HTML, no link, no end of a table's cell."""
    return "".join(_ENTITIES.get(c, f"\\{c}" if c in _ESCAPED else c) for c in text)


def page(entries: Sequence[Entry]) -> str:
    """The whole page; the same bytes for the same entries and reference scores.

    Raises:
        ValueError: an entry is on a robot that has no reference scores.
    """
    parts = [INTRODUCTION]
    tables = standings(entries)
    if not tables:
        parts.append("There are no entries yet.\n")
    for standing in tables:
        parts.append(_standing(standing))
        if any(cell.iqm.interval for row in standing.rows for cell in row.cells.values()):
            parts.append(_ranks(standing))
    if entries:
        parts.append("## Entries\n")
    parts += [_entry(row.entry) for standing in tables for row in standing.rows]
    return "\n".join(parts)


def score_text(cell: Cell | None) -> str:
    """`74.69 ± 4.22`, with the number of runs where it is not the full one; `–` for a robot without runs."""
    if cell is None:
        return "–"
    text = number_text(cell.mean) if cell.std is None else f"{number_text(cell.mean)} ± {number_text(cell.std)}"
    return text if cell.runs == RUNS else f"{text} ({cell.runs} run{'s' * (cell.runs != 1)})"


def iqm_text(cell: Cell | None) -> str:
    """`74.69 [70.10, 78.02]`, the interquartile mean and its interval; `–` where there are no two runs."""
    if cell is None or cell.iqm.interval is None:
        return "–"
    low, high = cell.iqm.interval
    return f"{number_text(cell.iqm.value)} [{number_text(low)}, {number_text(high)}]"


def rank_text(rank: Rank | None) -> str:
    """`2`, or `1–3` for a range of ranks; `–` for none."""
    if rank is None:
        return "–"
    return str(rank.best) if rank.best == rank.worst else f"{rank.best}–{rank.worst}"


def number_text(value: float) -> str:
    """A score with two decimals, never `-0.00`."""
    return f"{round(value, 2) + 0.0:.2f}"


def _standing(standing: Table) -> str:
    header = ["Agent", "Authors", *ids.ROBOTS, "Privileged", "Label"]
    lines = [_row(row) for row in standing.rows]
    data = data_scores()
    scores = [number_text(data[robot]) if robot in data else "–" for robot in ids.ROBOTS]
    lines.append(["*behaviour data*", "", *scores, "", "reference"])
    title = f"## {TRACKS[standing.track]}, {CHECKPOINTS[standing.checkpoint]}"
    return f"{title}\n\n{table(header, lines, numbers_from=None)}\n"


def _ranks(standing: Table) -> str:
    columns = [*ids.ROBOTS, "All robots"]
    lines = []
    for row in standing.rows:
        cells = [*(row.cells.get(robot) for robot in ids.ROBOTS), row.overall]
        texts = [
            f"{iqm_text(cell)}, {rank_text(cell.rank)}" if cell and cell.rank else iqm_text(cell) for cell in cells
        ]
        lines.append([escape(row.entry.submission.agent), *texts])
    return f"Interquartile mean [95 % interval], rank:\n\n{table(['Agent', *columns], lines, numbers_from=None)}\n"


def _row(row: Row) -> list[str]:
    submission = row.entry.submission
    cells = []
    for robot in ids.ROBOTS:
        cell = row.cells.get(robot)
        text = score_text(cell)
        cells.append(f"**{text}**" if cell is not None and cell.bold else text)
    agent = escape(submission.agent) + (" *(partial)*" if row.partial else "")
    return [agent, authors_text(submission.authors), *cells, submission.privileged, row.entry.label]


def authors_text(authors: Sequence[str]) -> str:
    """Up to three names, escaped; of more than three the first one and others."""
    return ", ".join(map(escape, authors)) if len(authors) <= 3 else f"{escape(authors[0])} *et al.*"


def _entry(entry: Entry) -> str:
    """What an entry says of itself, and its score in each dynamics."""
    submission = entry.submission
    links = [f"[{name}]({url.replace('&', '&amp;')})" for name, url in _links(entry)]
    steps = sorted({run.gradient_steps for run in submission.runs})
    mujoco = sorted({run.evaluation.mujoco for run in submission.runs})
    untold = f"; not given of {submission.untold} runs" if submission.commits and submission.untold else ""
    lines = [
        f"### {escape(submission.agent)} ({submission.track}, {submission.checkpoint})\n",
        f"- About: {escape(submission.description)}",
        f"- Authors: {', '.join(map(escape, submission.authors))}",
        f"- Links: {', '.join(links) or 'none'}",
        f"- Commit: {', '.join(submission.commits) or 'not given'}{untold}",
        f"- Training: {' or '.join(map(str, steps))} gradient steps a run, {submission.hours:.3g} hours in all, "
        f"on {escape(submission.hardware)}",
        f"- Evaluated with MuJoCo {' and '.join(map(escape, mujoco))}",
        f"- Versions: {', '.join(escape(f'{k} {v}') for k, v in sorted(submission.versions.items())) or 'not given'}\n",
        "Score in each test dynamics, on the scale of its own data, mean over runs:\n",
    ]
    labels = [name.label for name in ids.dynamics_ids(ids.ROBOTS[0], ("test",))]
    rows = [
        [robot, *(number_text(scores[label]) for label in labels)]
        for robot, scores in dynamics_scores(submission).items()
    ]
    return "\n".join([*lines, table(["Robot", *labels], rows, numbers_from=None)]) + "\n"


def _links(entry: Entry) -> list[tuple[str, str]]:
    submission = entry.submission
    return [(name, url) for name, url in (("paper", submission.paper), ("code", submission.code)) if url is not None]
