"""One progress bar on the error stream.

What is here: `track`. Called by everything of pictures that takes more than a moment. It must not know what is counted.
"""

from collections.abc import Iterable, Iterator
from typing import TypeVar

import rich.console
import rich.progress

Item = TypeVar("Item")


def track(items: Iterable[Item], description: str, total: int) -> Iterator[Item]:
    """Yield the items under a progress bar, which is gone when they end or the caller stops asking."""
    console = rich.console.Console(stderr=True)
    yield from rich.progress.track(items, description, total=total, console=console, transient=True)
