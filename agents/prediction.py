"""How well the next state is predicted: the errors of the paper's Table 3 and Figure 4.

What is here: the mean square error in each dynamics of a dataset. Called by `recording`, for what predicts and does not
act, and by `predict`. It must not know any predictor by name, nor run folders.

The data of each episode are cut into windows of K steps, 0 to K − 1, K to 2K − 1 and so on; what is left at the end is
a window that is padded. So each step is predicted once, one step ahead, by an agent that sees 0 to K − 1 steps before
it. The error is that of the normalised next state, by the statistics of the train data: the mean of its square over the
S elements and all steps of a dynamics. The error of a robot is the mean over its test dynamics, each counting the same.
"""

import dataclasses
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from agents.interface import Predictor
from dynagen_bench import ids
from dynagen_bench.datasets import Normalization, OfflineDataset, Windows, WindowSampler
from dynagen_bench.datasets.subsets import spread_episodes
from dynagen_bench.terminal import track

EPISODES: Final = 200
"""Of each test dynamics, where no other number is given: a fifth of the data tells what all of them do."""

BATCH: Final = 256
"""Windows in a forward pass: fewer keep a processor less busy, more do not fit its caches."""


@dataclasses.dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Mean square errors of normalised next states, one step ahead.

    Attributes:
        robot, split: of the data.
        dynamics: (M,) int64, indices in the split.
        errors: (M,) float64.
        unchanged: (M,) float64, errors of the present state in place of a prediction: what a predictor has to beat.
        steps: (M,) int64, that an error is the mean of.
    """

    robot: str
    split: str
    dynamics: NDArray[np.int64]
    errors: NDArray[np.float64]
    unchanged: NDArray[np.float64]
    steps: NDArray[np.int64]

    @property
    def mean(self) -> float:
        """Over the dynamics, each counting the same."""
        return float(self.errors.mean())

    def to_json(self) -> dict[str, Any]:
        """As JSON types, the mean among them."""
        lists = {field: getattr(self, field).tolist() for field in ("dynamics", "errors", "unchanged", "steps")}
        return {"robot": self.robot, "split": self.split, "mean": self.mean, **lists}


def prediction_errors(
    predictor: Predictor,
    dataset: OfflineDataset,
    normalization: Normalization,
    context: int,
    *,
    episodes: int | None = EPISODES,
    progress: bool = True,
) -> PredictionErrors:
    """Measure a predictor in each dynamics of a dataset.

    Args:
        predictor: computes in float32.
        dataset: any split; `test` for the paper's numbers.
        normalization: of the data that the predictor was trained on.
        context: K, steps of a window.
        episodes: of each dynamics at most this many, spread over their returns (`subsets.spread_episodes`); None takes
            all.
        progress: show a progress bar on the error stream.

    Raises:
        ValueError: no steps, a context or number of episodes below 1, or a normalisation of another observation.
        FloatingPointError: a prediction is not finite; the message names the dynamics.
    """
    if episodes is not None:
        dataset = dataset.select(spread_over(dataset, episodes))
    sampler = WindowSampler(dataset, context, normalization)
    starts, owners = tiles(dataset.episode_lengths, context)
    dynamics, of_episode = np.unique(dataset.episode_dynamics, return_inverse=True)
    of_window = of_episode[owners]
    squares, still = np.zeros(len(dynamics)), np.zeros(len(dynamics))
    steps = np.zeros(len(dynamics), dtype=np.int64)
    firsts = range(0, len(starts), BATCH)
    for first in track(firsts, f"{dataset.robot} next states", len(firsts), show=progress):
        part = slice(first, first + BATCH)
        windows = sampler.windows_at(starts[part])
        for total, square in (
            (squares, square_errors(predict(predictor, windows), windows)),
            (still, square_errors(windows.observations, windows)),
        ):
            total += np.bincount(of_window[part], square.sum(axis=1, dtype=np.float64), len(dynamics))
        steps += np.bincount(of_window[part], windows.mask.sum(axis=1), len(dynamics)).astype(np.int64)
    errors, unchanged = squares / np.maximum(steps, 1), still / np.maximum(steps, 1)
    if not np.isfinite(errors).all():
        worst = dynamics[np.argmin(np.isfinite(errors))]
        raise FloatingPointError(
            f"a next state of {dataset.robot} {dataset.split}{worst} is predicted to be no finite number: train again "
            "with a lower --learning-rate, or check the data"
        )
    return PredictionErrors(dataset.robot, dataset.split, dynamics, errors, unchanged, steps)


def predict(predictor: Predictor, windows: Windows) -> NDArray[np.float32]:
    """Normalised next states (B, K, S)."""
    with torch.inference_mode():
        predicted: NDArray[np.float32] = predictor.predict(windows).float().cpu().numpy()
    assert predicted.shape == windows.next_observations.shape, predicted.shape
    return predicted


def square_errors(predicted: NDArray[np.float32], windows: Windows) -> NDArray[np.float32]:
    """Square error of each step (B, K), the mean over the S elements; 0 at padding."""
    error = np.where(windows.mask[:, :, None], predicted - windows.next_observations, np.float32(0))
    mean: NDArray[np.float32] = np.square(error).mean(axis=2)
    return mean


def tiles(lengths: NDArray[np.int64], context: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First steps (W,), counted through all episodes, of the windows that tile them, and the episodes (W,) they are of.

    Args:
        lengths: (E,), steps of the episodes.
        context: K, steps of a window.
    """
    counts = -(-lengths // context)  # (E,) windows of an episode
    owners = np.repeat(np.arange(len(lengths)), counts)
    number = np.arange(len(owners)) - (np.cumsum(counts) - counts)[owners]  # of a window in its episode
    return (np.cumsum(lengths) - lengths)[owners] + number * context, owners


def spread_over(dataset: OfflineDataset, episodes: int) -> NDArray[np.int64]:
    """Numbers of the episodes that are at most `episodes` of each dynamics and stand for all its returns."""
    ids.check_count("episodes", episodes)
    chosen = []
    for dynamics in np.unique(dataset.episode_dynamics):
        own = np.flatnonzero(dataset.episode_dynamics == dynamics)
        chosen.append(own[spread_episodes(dataset.episode_returns[own], min(episodes, len(own)))])
    return np.concatenate(chosen)
