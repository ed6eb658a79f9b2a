"""One table, by hand, and the one that cannot be."""

import pytest

from dynagen_bench.markdown import table


def test_a_table_by_hand() -> None:
    assert table(["", "mean"], [["Hopper", "1.5"], ["Ant", "2"]]) == (
        "|  | mean |\n| --- | ---: |\n| Hopper | 1.5 |\n| Ant | 2 |"
    )


@pytest.mark.parametrize(
    ("numbers_from", "rule"),
    [(None, "| --- | --- | --- |"), (0, "| ---: | ---: | ---: |"), (2, "| --- | --- | ---: |")],
)
def test_columns_of_numbers_are_aligned_to_the_right(numbers_from: int | None, rule: str) -> None:
    assert table(["a", "b", "c"], [], numbers_from).splitlines()[1] == rule


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^1 cells \(Ant\) under 2 headings: give each its own$"):
        table(["", "mean"], [["Hopper", "1.5"], ["Ant"]])
