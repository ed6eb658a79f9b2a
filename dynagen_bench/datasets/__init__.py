"""The data in use: Minari in and out, flat arrays, windows, single steps, normalisation, reference scores."""

from dynagen_bench.datasets.flat import OfflineDataset, load_adaptation, load_dataset
from dynagen_bench.datasets.normalization import Normalization
from dynagen_bench.datasets.scores import Reference, normalized_score, reference_scores
from dynagen_bench.datasets.transitions import Transitions, TransitionSampler
from dynagen_bench.datasets.windows import Windows, WindowSampler

__all__ = [
    "Normalization",
    "OfflineDataset",
    "Reference",
    "TransitionSampler",
    "Transitions",
    "WindowSampler",
    "Windows",
    "load_adaptation",
    "load_dataset",
    "normalized_score",
    "reference_scores",
]
