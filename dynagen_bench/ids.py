"""Every id of the benchmark, built and parsed in one place.

What is here: the names of robots and splits, and the ids of environments and datasets made from them. Everything else
in the project calls it; it imports nothing of ours, and it must not know what an id stands for.

    Hopper-RandDyn-v0               the environment, dynamics chosen by keyword arguments
    Hopper-RandDyn-test3            the same environment, one dynamics
    dynagen/Hopper-RandDyn/test3-v0 the Minari dataset collected in it
"""

import dataclasses
import difflib
import operator
import re
from collections.abc import Iterator, Sequence
from typing import Any, Final

ROBOTS: Final = ("Walker", "Hopper", "HalfCheetah", "SlimHumanoid", "Ant")
SPLIT_SIZES: Final = {"train": 20, "test": 5, "nominal": 1}
"""Number of dynamics in each split: the paper's dynamics 0-19 and 20-24, and the unchanged robot."""

NAMESPACE: Final = "dynagen"
VERSION: Final = 0


@dataclasses.dataclass(frozen=True, order=True)
class DynamicsId:
    """One dynamics of one robot, by name: `DynamicsId("Hopper", "test", 3)`."""

    robot: str
    split: str
    index: int

    @property
    def label(self) -> str:
        """Split and index as one word, `test3`; `nominal` for the unchanged robot."""
        return self.split if self.split == "nominal" else f"{self.split}{self.index}"

    @property
    def key(self) -> tuple[int, int, int]:
        """Numbers of the robot, the split and the dynamics, from which all that is drawn of it is seeded."""
        return ROBOTS.index(self.robot), tuple(SPLIT_SIZES).index(self.split), self.index

    @property
    def env_id(self) -> str:
        """Gymnasium's id of this dynamics, `Hopper-RandDyn-test3`.

        Of `nominal` it is a name and no id: that one is made by `gymnasium.make(v0_env_id(robot), split="nominal")`.
        """
        return f"{self.robot}-RandDyn-{self.label}"

    @property
    def dataset_id(self) -> str:
        """Minari's id of the data of this dynamics, `dynagen/Hopper-RandDyn/test3-v0`."""
        return f"{NAMESPACE}/{self.robot}-RandDyn/{self.label}-v{VERSION}"

    def part_id(self, every: int) -> str:
        """Minari's id of the part of the data that has every n-th snapshot, `dynagen/Hopper-RandDyn/test3-every4-v0`.

        A part has a name of its own, so that it lies beside the whole and is never taken for it; 1 is the whole. Raises
        ValueError as `check_count` does.
        """
        number = check_count("every", every)
        if number == 1:
            return self.dataset_id
        return f"{NAMESPACE}/{self.robot}-RandDyn/{self.label}-every{number}-v{VERSION}"


def check_robot(robot: str) -> str:
    """Return `robot`; raise ValueError with the nearest known name if it is not one of `ROBOTS`."""
    if robot in ROBOTS:
        return robot
    near = difflib.get_close_matches(str(robot).capitalize(), ROBOTS, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise ValueError(f"unknown robot {robot!r}: choose one of {', '.join(ROBOTS)}{hint}")


def check_split(split: str) -> str:
    """Return `split`; raise ValueError naming the allowed ones if it is not in `SPLIT_SIZES`."""
    if isinstance(split, str) and split in SPLIT_SIZES:  # a list cannot even be looked for
        return split
    raise ValueError(f"unknown split {split!r}: choose one of {', '.join(SPLIT_SIZES)}")


def whole_number(given: Any) -> int | None:
    """`given` as a plain int, also if it is one of NumPy's; None if it is no whole number. True and False are none."""
    try:
        return None if isinstance(given, bool) else operator.index(given)
    except TypeError:
        return None


def check_count(name: str, given: Any, least: int = 1, most: int | None = None) -> int:
    """Return `given` as a plain int; raise ValueError, which calls it `name`, if it is none from `least` to `most`."""
    number = whole_number(given)
    if number is None or number < least or (most is not None and number > most):
        end = "on" if most is None else f"to {most}"
        raise ValueError(f"{name} is {given!r}: give a whole number from {least} {end}")
    return number


def check_index(split: str, index: int) -> int:
    """Return `index`, a plain int; raise ValueError with the allowed range if the split has no such dynamics."""
    size, number = SPLIT_SIZES[check_split(split)], whole_number(index)
    if number is None or not 0 <= number < size:
        raise ValueError(f"index {index!r} is not in split {split!r}: choose a whole number from 0 to {size - 1}")
    return number


def check_indices(split: str, indices: Sequence[int]) -> list[int]:
    """Return `indices` as plain ints; raise ValueError if they are no list of numbers of a split's dynamics."""
    try:
        given = list(indices)
    except TypeError:
        raise ValueError(f"indices is {indices!r}: give a list of whole numbers, as [0, 3]") from None
    return [check_index(split, index) for index in given]


def make_id(robot: str, split: str, index: int) -> DynamicsId:
    """Return the checked id of one dynamics; raises ValueError as the `check_` functions do."""
    return DynamicsId(check_robot(robot), check_split(split), check_index(split, index))


def choose_ids(robot: str, split: str, indices: Sequence[int] | None = None) -> list[DynamicsId]:
    """The ids of some dynamics of a split, in the order given; None takes all.

    Raises:
        ValueError: an unknown robot, split or index, no index at all, or one twice.
    """
    check_robot(robot)
    size = SPLIT_SIZES[check_split(split)]
    chosen = range(size) if indices is None else check_indices(split, indices)
    names = [make_id(robot, split, index) for index in chosen]
    if not names or len(set(names)) != len(names):
        given = [name.index for name in names]
        raise ValueError(f"indices {given} name no dynamics or one twice: give at least one, and none twice")
    return names


def v0_env_id(robot: str) -> str:
    """Gymnasium's id of a robot whose dynamics are chosen by keyword, `Hopper-RandDyn-v0`."""
    return f"{check_robot(robot)}-RandDyn-v{VERSION}"


def parse_label(robot: str, label: str) -> DynamicsId:
    """Parse `test3`, `train0` or `nominal` of a robot.

    Raises:
        ValueError: the label is of another form, or its index is outside the split.
    """
    if label == "nominal":
        return make_id(robot, "nominal", 0)
    match = re.fullmatch(r"(train|test)(0|[1-9]\d*)", label)
    if match is None:
        raise ValueError(f"unknown dynamics {label!r}: write train0 to train19, test0 to test4, or nominal")
    return make_id(robot, match[1], int(match[2]))


def dynamics_ids(robot: str, splits: tuple[str, ...] = ("train", "test")) -> Iterator[DynamicsId]:
    """Yield the ids of a robot's dynamics, split by split, in order of index."""
    check_robot(robot)
    for split in splits:
        for index in range(SPLIT_SIZES[check_split(split)]):
            yield DynamicsId(robot, split, index)
