"""Which episodes make a part of the data: the worst by return, and some that are spread over all returns.

What is here: the choice, as numbers of episodes. Called by `load_dataset` and `load_adaptation`, by data cards, and by
agents for what they measure. It must not know arrays of steps, files or splits: a part is a view, made by
`OfflineDataset.select`.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dynagen_bench.ids import check_count

ADAPTATION_EPISODES: Final = 10
"""Size of the adaptation set of one test dynamics. The paper takes "a fixed number of samples" of each (section 4), and
does not say how many."""


def worst_episodes(returns: NDArray[np.floating[Any]], quality: float) -> NDArray[np.int64]:
    """Numbers of the episodes with the lowest returns, ascending.

    The paper sorts the trajectories of the offline dataset by return and takes the share from the lowest on (figure 5).
    So all dynamics are sorted together, and those in which returns are low give more: a body of small returns may be
    there with all of its episodes.

    Args:
        returns: (E,), of all train dynamics together.
        quality: the share of the episodes, above 0 and at most 1; the count is rounded to the nearest, and at least 1.
            Of equal returns the earlier episode is the worse.

    Raises:
        ValueError: `quality` is no such share.
    """
    check_quality(quality)
    count = max(1, round(quality * len(returns)))
    return np.sort(np.argsort(returns, kind="stable")[:count])


def check_quality(quality: float) -> None:
    """Raise ValueError unless it is a share of the episodes, above 0 and at most 1."""
    if isinstance(quality, bool) or not isinstance(quality, int | float | np.floating) or not 0 < quality <= 1:
        raise ValueError(f"quality is {quality!r}: give a share of the episodes, above 0 and at most 1")


def spread_episodes(returns: NDArray[np.floating[Any]], count: int) -> NDArray[np.int64]:
    """Numbers of `count` episodes that stand for all qualities, ascending.

    The episodes are sorted by return and cut into `count` groups of the same size; of each its middle one is taken. Ten
    of a thousand are those of rank 50, 150, ..., 950: neither the best nor the worst of all, which are outliers.

    Args:
        returns: (E,), of one dynamics.
        count: how many, from 1 to E. Of equal returns the earlier episode is the worse.

    Raises:
        ValueError: `count` is no such number.
    """
    groups = check_count("episodes", count, most=len(returns))
    ranks = (2 * np.arange(groups) + 1) * len(returns) // (2 * groups)
    return np.sort(np.argsort(returns, kind="stable")[ranks])
