"""The cache of flat arrays: written once from Minari datasets, memory-mapped ever after.

What is here: the files of `OfflineDataset`'s arrays, one `.npy` file per array, in a folder whose name tells what they
are made from. Called by `load_dataset`. It must not know robots, splits or what is done with the arrays.
"""

import errno
import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import platformdirs
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from dynagen_bench.collection.contents import DatasetRecord, build_command, read_episodes
from dynagen_bench.collection.episodes import Episode
from dynagen_bench.terminal import track
from dynagen_bench.whole import exclusively, whole_folder

LAYOUT_VERSION: Final = 1
"""Counts the changes of `OfflineDataset`'s layout: each has folders of its own."""

ROW_ARRAYS: Final = ("observations", "actions", "rewards", "returns_to_go")
"""Arrays with a row per step, memory-mapped; the others are of an episode each and small."""

LAYOUT: Final[dict[str, type]] = {
    **dict.fromkeys(ROW_ARRAYS, np.float32),
    **dict.fromkeys((f"episode_{what}" for what in ("starts", "lengths", "dynamics", "snapshots", "seeds")), np.int64),
    "episode_returns": np.float64,
    "episode_terminated": np.bool_,
}
"""Every array of `OfflineDataset` and the type of its elements."""

Arrays = dict[str, NDArray[Any]]


class Source(NamedTuple):
    """One Minari dataset that arrays are made from."""

    dynamics: int
    """Index of its dynamics in the split."""
    folder: Path
    record: DatasetRecord


def cache_folder() -> Path:
    """Where flat arrays are kept: `DYNAGEN_CACHE`, or the platform's cache folder. It may be emptied at any time."""
    return Path(os.environ.get("DYNAGEN_CACHE") or platformdirs.user_cache_dir("dynagen-bench"))


def map_arrays(label: str, sources: Sequence[Source], progress: bool) -> Arrays:
    """The arrays of `OfflineDataset` by name, made first if they are not all there.

    Args:
        label: how the folder's name begins, for a reader of the cache.
        sources: the Minari datasets, in order.
        progress: show a progress bar on the error stream while arrays are made.

    Raises:
        ValueError: a dataset is damaged: its episodes cannot be read, or are not those that it records.
        OSError: the disk has no room for them; nothing is left of them then.
    """
    folder = cache_folder() / f"flat-v{LAYOUT_VERSION}" / f"{label}-{_key(sources)}"
    if (arrays := _kept_arrays(folder)) is not None:
        return arrays
    with exclusively(folder):
        if (arrays := _kept_arrays(folder)) is not None:
            return arrays  # another process made them while this one waited
        with whole_folder(folder) as unfinished:
            _write_arrays(unfinished, label, sources, progress)
        return _load_arrays(folder)


def _kept_arrays(folder: Path) -> Arrays | None:
    """The arrays of a folder in the cache, or None if they have to be made: it may have been emptied in part."""
    try:
        return _load_arrays(folder)
    except Exception:  # a file that was cut or changed makes numpy fail in any way it can
        return None


def _load_arrays(folder: Path) -> Arrays:
    return {name: np.load(folder / f"{name}.npy", mmap_mode="r" if name in ROW_ARRAYS else None) for name in LAYOUT}


def _key(sources: Sequence[Source]) -> str:
    """What arrays are made from, as one word: other content, or a file changed in its place, gives another word."""
    parts = []
    for source in sources:
        try:
            file = (source.folder / "data" / "main_data.hdf5").stat()
        except FileNotFoundError:
            raise _damaged(source, "it has no main_data.hdf5") from None
        parts.append([source.dynamics, source.record.sha256, file.st_size, file.st_mtime_ns])
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def _write_arrays(folder: Path, label: str, sources: Sequence[Source], progress: bool) -> None:
    episodes = sum(source.record.episodes for source in sources)
    rows = sum(source.record.steps for source in sources) + episodes
    about: Arrays = {name: np.zeros(episodes, dtype) for name, dtype in LAYOUT.items() if name not in ROW_ARRAYS}
    arrays: Arrays = {}
    row = number = 0
    for source, episode in _checked_episodes(sources, f"flat arrays of {label}", progress):
        if not arrays:
            arrays = _row_arrays(folder, rows, episode)
        last = row + len(episode)
        arrays["observations"][row : last + 1] = episode.observations
        arrays["actions"][row:last] = episode.actions
        arrays["rewards"][row:last] = episode.rewards
        arrays["returns_to_go"][row:last] = np.cumsum(episode.rewards[::-1])[::-1]
        about["episode_starts"][number] = row
        about["episode_lengths"][number] = len(episode)
        about["episode_dynamics"][number] = source.dynamics
        about["episode_snapshots"][number] = episode.snapshot
        about["episode_returns"][number] = episode.total_reward
        about["episode_seeds"][number] = episode.seed
        about["episode_terminated"][number] = episode.terminated
        row, number = last + 1, number + 1
    for array in arrays.values():
        array.flush()  # type: ignore[attr-defined]  # np.memmap
    for name, values in about.items():
        np.save(folder / f"{name}.npy", values)


def _row_arrays(folder: Path, rows: int, example: Episode) -> Arrays:
    """Files of M zero rows: what is not written stays zero, as the last row of an episode wants it."""
    widths = {"observations": example.observations.shape[1:], "actions": example.actions.shape[1:]}
    arrays: Arrays = {}
    for name in ROW_ARRAYS:
        file = folder / f"{name}.npy"
        arrays[name] = open_memmap(file, "w+", LAYOUT[name], (rows, *widths.get(name, ())))
        _reserve(file)
    return arrays


def _reserve(file: Path) -> None:
    """Take the disk space of a file: a new memory map has none yet, and writing to it on a full disk kills the process.

    Raises:
        OSError: there is not enough.
    """
    if not hasattr(os, "posix_fallocate"):  # macOS
        return
    size = file.stat().st_size
    try:
        with file.open("r+b") as opened:
            os.posix_fallocate(opened.fileno(), 0, size)
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.EOPNOTSUPP):
            return  # this file system reserves nothing
        raise OSError(
            f"no room for {size / 1e6:.0f} MB in {cache_folder()} ({error.strerror}): make some there, or let "
            "DYNAGEN_CACHE name a folder that has more"
        ) from error


def _checked_episodes(sources: Sequence[Source], title: str, progress: bool) -> Iterator[tuple[Source, Episode]]:
    """All episodes in order; those of a dataset come when all of them have been compared with its record."""
    every = ((source, episode) for source in sources for episode in _recorded_episodes(source))
    return track(every, title, sum(source.record.episodes for source in sources), progress)


def _recorded_episodes(source: Source) -> list[Episode]:
    try:
        episodes = list(read_episodes(source.folder))
        right = source.record.is_of(episodes)
    except Exception as error:  # a changed byte makes h5py, numpy or Minari fail in any way they can
        raise _damaged(source, f"its episodes cannot be read, {type(error).__name__}") from error
    if not right:
        raise _damaged(source, "its episodes are not those it records")
    return episodes


def _damaged(source: Source, reason: str) -> ValueError:
    robot, _, _ = str(source.record.recipe["dynamics"]).partition("-")
    again = build_command(robot, source.record.recipe["every"])
    return ValueError(f"{source.folder} is damaged: {reason}; build it again with `{again}`")
