"""What a job is: a function by its name, plain data, and the files it makes.

What is here: `Job`, its key, and what is refused. Called by everything in this package and by whoever has work to give.
It must not know where or when a job runs.
"""

import dataclasses
import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, Final

from dynagen_bench.ids import check_count

RECORDS: Final = ".jobs"
"""The folder, in the folder of the results, of records, logs and scratch folders."""

Report = Callable[[int], None]
"""Called by a job as `report(units done)`; as often as it likes, few of the calls are passed on."""

_FUNCTION: Final = re.compile(r"(?!__main__)\w+(\.\w+)*:\w+")


@dataclasses.dataclass(frozen=True)
class Job:
    """One piece of work, run as `function(scratch, report, **arguments)` in a fresh process.

    `scratch` is a folder of its own, where the function leaves `outputs`. It survives the process: what a job that was
    killed left there, a checkpoint say, its next attempt finds.

    Attributes:
        name: shown; no two of one call have the same.
        function: "package.module:function", importable in a fresh process.
        arguments: plain JSON data by keyword: dicts, lists, strings, finite numbers, booleans, None.
        outputs: files it makes, as paths with "/" relative to the folder of the results. They appear there in this
            order. Other arguments should make other files.
        total: units of its progress.

    Raises:
        ValueError: one of these is something else.
    """

    name: str
    function: str
    arguments: Mapping[str, Any]
    outputs: tuple[str, ...]
    total: int

    def __post_init__(self) -> None:
        if not _FUNCTION.fullmatch(self.function):
            raise ValueError(
                f"job {self.name!r}: function is {self.function!r}: give 'package.module:function', which a fresh "
                "process can import"
            )
        if not _is_plain(self.arguments):
            raise ValueError(
                f"job {self.name!r}: its arguments are no plain JSON data: give dicts with string keys, lists, "
                f"strings, finite numbers, booleans and None, not {self.arguments!r}"
            )
        if not self.outputs or len(set(self.outputs)) != len(self.outputs) or not all(map(_is_inside, self.outputs)):
            raise ValueError(
                f"job {self.name!r}: outputs are {self.outputs!r}: give at least one path, each once, relative to the "
                "folder of the results and inside it"
            )
        check_count(f"job {self.name!r}: total", self.total)

    @property
    def key(self) -> str:
        """SHA-256, hexadecimal, of function, arguments and outputs: names its record, log and scratch folder."""
        content = {"function": self.function, "arguments": dict(self.arguments), "outputs": list(self.outputs)}
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def check_jobs(jobs: Sequence[Job]) -> None:
    """Refuse jobs that would be taken for one another.

    Raises:
        ValueError: two have one name, or make one file.
    """
    names: set[str] = set()
    makers: dict[str, str] = {}
    for job in jobs:
        if job.name in names:
            raise ValueError(f"two jobs have the name {job.name!r}: give each its own")
        names.add(job.name)
        for output in job.outputs:
            if output in makers:
                raise ValueError(f"jobs {makers[output]!r} and {job.name!r} both make {output}: give each its own file")
            makers[output] = job.name


def _is_plain(arguments: Mapping[str, Any]) -> bool:
    """Whether JSON gives back just what it was given: no tuple, no NaN, no number as a key."""
    try:
        back = json.loads(json.dumps(dict(arguments), allow_nan=False))
    except (TypeError, ValueError):
        return False
    return bool(back == dict(arguments))


def _is_inside(output: str) -> bool:
    """Whether a path stays in the folder of the results, is written in one way only, and is none of the records."""
    path = PurePosixPath(output)
    return str(path) == output != "." and not path.is_absolute() and ".." not in path.parts and path.parts[0] != RECORDS
