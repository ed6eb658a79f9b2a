"""A table in Markdown, the one way that every page made here writes one.

What is here: `table`. Called by the pages of environments, data, results, the leaderboard and the benchmarks' ratios.
It must not know what the cells say: what came from outside is escaped before it comes here.
"""

from collections.abc import Iterable, Sequence


def table(header: Sequence[str], rows: Iterable[Sequence[str]], numbers_from: int | None = 1) -> str:
    """Lines of a table, without the last line's end.

    Args:
        header: one text a column.
        rows: as many texts each.
        numbers_from: the first column that is aligned to the right, as are all after it; None: no column is.

    Raises:
        ValueError: a row has another number of cells than the header: the table would be a broken one.
    """
    texts = len(header) if numbers_from is None else numbers_from
    rule = ["---" if column < texts else "---:" for column in range(len(header))]
    lines = [header, rule, *rows]
    for line in lines:
        if len(line) != len(header):
            raise ValueError(f"{len(line)} cells ({', '.join(line)}) under {len(header)} headings: give each its own")
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
