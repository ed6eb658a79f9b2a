"""The numbers that the paper published, apart from every table of entries.

What is here: `PUBLISHED`, its Tables 1, 2 and 7, `PUBLISHED_ERRORS`, its Table 3, and `PUBLISHED_WEIGHTS`, its Table 4.
Called by the site and the page of the reference results. They are of other draws of the dynamics, so they are not
comparable in value with an entry's.
"""

from typing import Final, NamedTuple

from dynagen_bench import ids
from leaderboard.statistics import near_best


class Score(NamedTuple):
    """Mean and standard deviation over five runs, in per cent of the paper's own scale."""

    mean: float
    std: float
    bold: bool = False
    """Within one standard deviation of the best of its column, the paper's rule, applied to the numbers here."""


class PublishedRow(NamedTuple):
    """One method; an adapted one is another row than the same zero-shot."""

    agent: str
    source: str
    cells: tuple[Score | None, ...]
    """In the order of `ROBOTS`; None where the text that this was taken from has lost it."""


class PublishedTable(NamedTuple):
    """Rows that the paper compares with each other."""

    number: int
    """Of the paper's table."""
    title: str
    rows: tuple[PublishedRow, ...]


ROBOTS: Final = ids.ROBOTS[:5]
"""The paper's, in the order of its tables; a robot that is added after them has no number of the paper's."""


def _row(agent: str, source: str, *scores: tuple[float, float] | None) -> PublishedRow:
    assert len(scores) == len(ROBOTS), agent
    return PublishedRow(agent, source, tuple(score and Score(*score) for score in scores))


def _table(number: int, title: str, *rows: PublishedRow) -> PublishedTable:
    """The rows with what is bold marked; each column has its own best."""
    columns = zip(*(row.cells for row in rows), strict=True)
    lines = [near_best((cell.mean, cell.std) for cell in column if cell) for column in columns]
    marked = []
    for row in rows:
        pairs = zip(row.cells, lines, strict=True)
        marked.append(row._replace(cells=tuple(cell and cell._replace(bold=cell.mean >= line) for cell, line in pairs)))
    return PublishedTable(number, title, tuple(marked))


_FOCAL, _MERPO, _DT, _TT = "Li et al., 2020", "Lin et al., 2022", "Chen et al., 2021", "Janner et al., 2021"

_DADT = ((61.12, 4.99), (74.69, 4.22), (16.29, 1.95), (42.03, 1.68), (35.87, 1.62))
_ADAPTED = ((64.65, 4.42), (83.11, 3.28), (23.48, 3.39), (39.58, 1.79), (54.85, 1.81))

PUBLISHED: Final = (
    _table(
        1,
        "Zero-shot",
        _row("FOCAL", _FOCAL, (52.44, 17.31), (41.56, 12.44), (10.60, 4.10), (20.45, 1.60), (18.73, 1.28)),
        _row("MerPO", _MERPO, (40.67, 6.66), (53.21, 1.89), (8.06, 1.09), (33.73, 1.41), (31.34, 0.80)),
        _row("DADT", "the paper", *_DADT),
    ),
    _table(
        1,
        "Adaptation",
        _row("MerPO", _MERPO, (48.11, 6.95), (57.38, 6.24), (14.36, 3.27), (32.51, 1.52), (37.08, 0.79)),
        _row("DADT", "the paper", *_ADAPTED),
    ),
    _table(
        2,
        "Zero-shot, transformers",
        _row("Transformer-BC", "", (46.50, 7.66), (62.63, 7.25), (16.31, 2.87), (38.87, 3.94), (34.37, 0.48)),
        _row("DT", _DT, (59.81, 6.30), (71.49, 4.66), (20.86, 2.30), (39.93, 3.62), (32.04, 2.28)),
        _row("DADT", "the paper", *_DADT),
    ),
    _table(
        7,
        "Zero-shot, Trajectory Transformer",
        _row("Trajectory Transformer", _TT, (45.76, 12.08), (55.22, 6.42), None, None, None),
        _row("DADT", "the paper", *_DADT),
    ),
    _table(
        7,
        "Adaptation, Trajectory Transformer",
        _row("Trajectory Transformer", _TT, (32.74, 3.30), (15.26, 6.26), None, None, None),
        _row("DADT", "the paper", *_ADAPTED),
    ),
)

PUBLISHED_ERRORS: Final = {
    "DT+": ((0.2314, 0.0050), (0.3346, 0.0115), (0.8001, 0.0157), (0.4766, 0.0113), (0.6160, 0.0522)),
    "DADT": ((0.0105, 0.0003), (0.0180, 0.0004), (0.0368, 0.0051), (0.0230, 0.0004), (0.0094, 0.0005)),
}
"""Table 3: mean and standard deviation of the next-state error, in the order of `ROBOTS`. It names no unit."""

PUBLISHED_WEIGHTS: Final = {
    "0.01": Score(45.56, 19.58),
    "0.05": Score(46.17, 20.74),
    "0.1": Score(45.97, 20.93),
    "0.5": Score(45.62, 19.83),
    "1.0": Score(44.10, 19.55),
}
"""Table 4: λ → DADT's score over all robots; the deviation is over robots and runs together."""
