"""Braces expanded as a shell does: `{a,b} {0..2}` → `a 0`, `a 1`, `a 2`, `b 0`, `b 1`, `b 2`.

What is here: `expand`. Called by `sweep_plan`. It must not know what it expands.

A text is expanded as if the shell saw one word: spaces are characters like others. Lists may be nested and have empty
choices; a range is one of whole numbers. What is neither, such as `{a}` or a brace without its other half, stays as it
is, and so do the shell's other ranges, of letters and with leading zeros.
"""

import itertools
import re
from collections.abc import Iterable, Iterator
from typing import Final

_RANGE: Final = re.compile(r"(0|-?[1-9]\d*)\.\.(0|-?[1-9]\d*)")


def expand(text: str) -> Iterator[str]:
    """The texts that a text with braces stands for, the last brace's choices changing fastest; no two calls differ."""
    start = text.find("{")
    while start >= 0:
        end, commas = _closing(text, start)
        choices = None if end is None else _choices(text, [start, *commas, end])
        if end is not None and choices is not None:
            before, after = text[:start], text[end + 1 :]
            for choice in choices:
                for rest in expand(after):
                    yield before + choice + rest
            return
        start = text.find("{", start + 1)  # this brace stands for itself
    yield text


def _closing(text: str, start: int) -> tuple[int | None, list[int]]:
    """Where the brace at `start` is closed, if it is, and where commas part what is between."""
    depth, commas = 0, list[int]()
    for place in range(start, len(text)):
        match text[place]:
            case "{":
                depth += 1
            case "}":
                depth -= 1
                if depth == 0:
                    return place, commas
            case "," if depth == 1:
                commas.append(place)
    return None, []


def _choices(text: str, marks: list[int]) -> Iterable[str] | None:
    """The choices between marks (brace, commas, brace); None if there is no choice to make."""
    parts = [text[first + 1 : last] for first, last in itertools.pairwise(marks)]
    if len(parts) > 1:
        return (choice for part in parts for choice in expand(part))
    found = _RANGE.fullmatch(parts[0])
    if found is None:
        return None
    low, high = int(found[1]), int(found[2])
    step = 1 if low <= high else -1
    return map(str, range(low, high + step, step))
