"""The board as a Markdown page.

What is here: `page`, and the escaping of every text that came with an entry. Called by `board`. It must not compute
scores.
"""

from collections.abc import Iterable, Sequence
from typing import Final

from dynagen_bench import ids
from dynagen_bench.envs import HORIZON
from dynagen_bench.evaluation import EPISODES
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

LABEL: Final = "self-reported"
"""What is known of an entry's returns: they were sent in, and nobody has run the policy again."""

INTRODUCTION: Final = f"""\
# Leaderboard

Made by `python -m leaderboard build` from the entries beside it; changes by hand are lost.

A score is 100 · (mean return − min) / (max − min): {EPISODES} episodes of up to {HORIZON} steps in each test dynamics
of a robot, min and max over the returns of those dynamics' data. Given is the mean over runs ± their sample standard
deviation; **bold** is within one standard deviation of the best of its table. A full entry has {RUNS} runs on each of
the {len(ids.ROBOTS)} robots, others are marked *partial*. Every number is computed from the returns of the entry's
episodes; *{LABEL}* says that nobody has replayed them yet. The behaviour data were collected in the test dynamics
themselves: a reference, and no entry.
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
    parts += [_table(table) for table in tables]
    if entries:
        parts.append("## Entries\n")
    parts += [_entry(row.entry) for table in tables for row in table.rows]
    return "\n".join(parts)


def score_text(cell: Cell | None) -> str:
    """`74.69 ± 4.22`, with the number of runs where it is not the full one; `–` for a robot without runs."""
    if cell is None:
        return "–"
    text = number_text(cell.mean) if cell.std is None else f"{number_text(cell.mean)} ± {number_text(cell.std)}"
    return text if cell.runs == RUNS else f"{text} ({cell.runs} run{'s' * (cell.runs != 1)})"


def number_text(value: float) -> str:
    """A score with two decimals, never `-0.00`."""
    return f"{round(value, 2) + 0.0:.2f}"


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |\n"


def _table(table: Table) -> str:
    header = ["Agent", "Authors", *ids.ROBOTS, "Privileged", "Label"]
    lines = [
        f"## {TRACKS[table.track]}, {CHECKPOINTS[table.checkpoint]}\n\n",
        _line(header),
        _line(["---"] * len(header)),
    ]
    lines += [_line(_row(row)) for row in table.rows]
    data = data_scores()
    scores = [number_text(data[robot]) if robot in data else "–" for robot in ids.ROBOTS]
    lines.append(_line(["*behaviour data*", "", *scores, "", "reference"]))
    return "".join(lines)


def _row(row: Row) -> list[str]:
    submission = row.entry.submission
    cells = []
    for robot in ids.ROBOTS:
        cell = row.cells.get(robot)
        text = score_text(cell)
        cells.append(f"**{text}**" if cell is not None and cell.bold else text)
    agent = escape(submission.agent) + (" *(partial)*" if row.partial else "")
    return [agent, authors_text(submission.authors), *cells, submission.privileged, LABEL]


def authors_text(authors: Sequence[str]) -> str:
    """Up to three names, escaped; of more than three the first one and others."""
    return ", ".join(map(escape, authors)) if len(authors) <= 3 else f"{escape(authors[0])} *et al.*"


def _entry(entry: Entry) -> str:
    """What an entry says of itself, and its score in each dynamics."""
    submission = entry.submission
    links = [f"[{name}]({url.replace('&', '&amp;')})" for name, url in _links(entry)]
    steps = sorted({run.gradient_steps for run in submission.runs})
    mujoco = sorted({run.evaluation.mujoco for run in submission.runs})
    lines = [
        f"### {escape(submission.agent)} ({submission.track}, {submission.checkpoint})\n",
        f"- About: {escape(submission.description)}",
        f"- Authors: {', '.join(map(escape, submission.authors))}",
        f"- Links: {', '.join(links) or 'none'}",
        f"- Commit: {submission.commit or 'not given'}",
        f"- Training: {' or '.join(map(str, steps))} gradient steps a run, {submission.hours:g} hours in all, "
        f"on {escape(submission.hardware)}",
        f"- Evaluated with MuJoCo {' and '.join(map(escape, mujoco))}",
        f"- Versions: {', '.join(escape(f'{k} {v}') for k, v in sorted(submission.versions.items())) or 'not given'}\n",
        "Score in each test dynamics, on the scale of its own data, mean over runs:\n",
    ]
    labels = [name.label for name in ids.dynamics_ids(ids.ROBOTS[0], ("test",))]
    text = "\n".join(lines) + "\n" + _line(["Robot", *labels]) + _line(["---"] * (1 + len(labels)))
    for robot, scores in dynamics_scores(submission).items():
        text += _line([robot, *(number_text(scores[label]) for label in labels)])
    return text


def _links(entry: Entry) -> list[tuple[str, str]]:
    submission = entry.submission
    return [(name, url) for name, url in (("paper", submission.paper), ("code", submission.code)) if url is not None]
