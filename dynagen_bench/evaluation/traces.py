"""Traces: what each episode of an evaluation did, exact enough to be stepped again by somebody else.

What is here: `Traces`, its recorder, its file, and the digest of this machine's physics. Called by `evaluate`, by
submissions and by the leaderboard, which replays it. It must not know policies, submissions or scores.

An episode of L steps has its L actions and its physics states (qpos, then qvel) before the steps 0, 10, 20, ... below
L and after the last one: ⌈L / 10⌉ + 1 states. A segment is what lies between two of them. The file has the episodes of
an evaluation one after another, in the order of its rows, as two safetensors arrays; it holds no length and no seed:
the evaluation has those, and one says what the other has to look like.

    actions  (all steps, A) float32
    states   (all stored states, X) float64, X = nq + nv
"""

import dataclasses
import functools
import hashlib
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.dynamics import compile_nominal, load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics
from dynagen_bench.whole import write_whole

INTERVAL: Final = 10
"""Steps between two stored states: few, so that another machine's rounding stays small over a segment
(docs/submissions.md), and enough that states take about as much room as actions."""

MAX_HEADER: Final = 1024
"""Largest header of a trace file that is read, bytes; `Traces` writes about 150."""

MAX_STATE: Final = 1e12
"""No state is larger: MuJoCo calls positions and velocities above 1e10 bad before every substep (mjMAXVAL)."""

DIGEST_STEPS: Final = HORIZON
"""Of the episodes whose hash says how a machine computes. Fifty of one body did not tell a C library's sine from
another's in HalfCheetah, whose episodes of other bodies then differed in their last bits."""


@dataclasses.dataclass(frozen=True, eq=False)
class Traces:
    """What N episodes of one robot did, one after another; files and submissions name them by `sha256`.

    Attributes:
        lengths: (N,) int64, steps of each episode, 1 to 200.
        actions: (Σ L, A) float32, what the policy chose, before it is clipped to the actuators' range.
        states: (Σ ⌈L / 10⌉ + 1, X) float64, m, rad, m/s and rad/s.
    """

    lengths: NDArray[np.int64]
    actions: NDArray[np.float32]
    states: NDArray[np.float64]

    @functools.cached_property
    def content(self) -> bytes:
        """The bytes of the file; the same for the same episodes."""
        # safetensors writes memory as it lies: only an array in C order reads back as itself
        actions, states = np.ascontiguousarray(self.actions, "<f4"), np.ascontiguousarray(self.states, "<f8")
        arrays = {"actions": actions, "states": states}
        content: bytes = safetensors.numpy.save(arrays)
        return content

    @property
    def sha256(self) -> str:
        """SHA-256 of the file, hexadecimal."""
        return hashlib.sha256(self.content).hexdigest()


class Recorder:
    """Takes down N episodes while they run side by side, one per lane."""

    def __init__(self, starts: NDArray[np.float64], actions: int) -> None:
        """Begin at the states (N, X), with `actions` numbers in an action."""
        lanes, size = starts.shape
        self._actions = np.zeros((lanes, HORIZON, actions), dtype=np.float32)
        self._states = np.zeros((lanes, HORIZON // INTERVAL + 1, size))
        self._states[:, 0] = starts

    def add(
        self,
        step: int,
        lanes: NDArray[np.intp],
        actions: NDArray[np.float32],
        states: NDArray[np.float64],
        ended: NDArray[np.bool_],
    ) -> None:
        """Take down step number `step` of lanes (M,): actions (M, A), new states (M, X), which are last (M,)."""
        self._actions[lanes, step] = actions
        due = np.ones(len(lanes), dtype=np.bool_) if (step + 1) % INTERVAL == 0 else ended
        self._states[lanes[due], -(-(step + 1) // INTERVAL)] = states[due]

    def traces(self, lengths: NDArray[np.int64]) -> Traces:
        """What was taken down, of episodes of these lengths (N,)."""
        steps = np.arange(HORIZON) < lengths[:, None]
        stored = np.arange(self._states.shape[1]) < stored_states(lengths)[:, None]
        return Traces(lengths.copy(), self._actions[steps], self._states[stored])


def stored_states(lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many states the trace of an episode of L steps holds, ⌈L / 10⌉ + 1, for each of (N,)."""
    return -(-lengths // INTERVAL) + 1


@functools.cache
def sizes(robot: str) -> tuple[int, int]:
    """A and X of a robot: numbers in an action and in a physics state; raises ValueError for an unknown robot."""
    model = compile_nominal(ids.check_robot(robot))
    return int(model.nu), int(model.nq + model.nv)


def file_size(robot: str, lengths: NDArray[np.int64]) -> int:
    """Bytes that the file of episodes of these lengths (N,) has at most."""
    actions, states = sizes(robot)
    return 8 + MAX_HEADER + 4 * actions * int(lengths.sum()) + 8 * states * int(stored_states(lengths).sum())


def parse_traces(content: bytes, robot: str, lengths: NDArray[np.int64]) -> Traces:
    """Read the bytes of a trace file; nothing in them is executed, decompressed or believed.

    Args:
        content: the file, not larger than `file_size`.
        robot: whose episodes they have to be.
        lengths: (N,) int64, how long they have to be.

    Raises:
        ValueError: the bytes are of another form, or hold a number that cannot be; one line naming the array.
    """
    if len(content) < 8 or int.from_bytes(content[:8], "little") > MAX_HEADER:
        raise ValueError(f"not a trace file: it does not begin with a safetensors header of at most {MAX_HEADER} bytes")
    try:
        found: dict[str, dict[str, Any]] = dict(safetensors.deserialize(content))  # type: ignore[no-untyped-call]
    except (safetensors.SafetensorError, ValueError) as error:
        said = "".join(c if c.isprintable() else "?" for c in str(error))[:200]
        raise ValueError(f"not a trace file: {said}") from error
    if sorted(found) != ["actions", "states"]:
        raise ValueError(f"it holds {len(found)} arrays: give `actions` and `states`, and no other")
    width, size = sizes(robot)
    actions = _array(found, "actions", "F32", (int(lengths.sum()), width))
    states = _array(found, "states", "F64", (int(stored_states(lengths).sum()), size))
    _check_numbers("actions", actions, lengths, 1)
    _check_numbers("states", states, stored_states(lengths), INTERVAL)
    return Traces(lengths, actions, states)


def _array(found: dict[str, dict[str, Any]], name: str, dtype: str, shape: tuple[int, int]) -> NDArray[Any]:
    given = found[name]
    if given["dtype"] != dtype or tuple(given["shape"]) != shape:
        raise ValueError(
            f"{name}: {given['dtype']} of shape {str(given['shape'])[:60]}, "
            f"episodes of these lengths have {dtype} of shape {list(shape)}"
        )
    return np.frombuffer(given["data"], dtype={"F32": "<f4", "F64": "<f8"}[dtype]).reshape(shape)


def _check_numbers(name: str, array: NDArray[Any], counts: NDArray[np.int64], steps: int) -> None:
    """Raise ValueError if a row is not finite or, of states, beyond physics; `counts` are an episode's rows."""
    limit = MAX_STATE if name == "states" else float(np.finfo(np.float32).max)
    with np.errstate(invalid="ignore"):
        bad = np.flatnonzero(~(np.abs(array) <= limit).all(axis=1))
    if len(bad):
        episode = int(np.searchsorted(np.cumsum(counts), bad[0], side="right"))
        step = steps * int(bad[0] - counts[:episode].sum())
        raise ValueError(f"{name}: episode {episode}, step {step}: a number is not finite or beyond ±{limit:g}")


def save_traces(path: Path, traces: Traces) -> None:
    """Write a trace file, whole or not at all."""
    write_whole(path, traces.content)


def load_traces(path: Path, robot: str, lengths: NDArray[np.int64]) -> Traces:
    """Read a trace file of one's own; raises as `parse_traces` does, with the file's name, or FileNotFoundError."""
    if not path.is_file():
        raise FileNotFoundError(f"{path} is no file: evaluate again, with traces")
    try:
        return parse_traces(path.read_bytes(), robot, lengths.ravel())
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


@functools.cache
def physics_digest(robot: str) -> str:
    """16 hexadecimal digits of how this machine computes: machines of the same digest are held to exact replays.

    It is of the states and rewards of an episode of random actions in each test dynamics, and of MuJoCo's version: the
    same arithmetic gives the same digest, whatever a processor or a C library is called. Raises ValueError for an
    unknown robot.
    """
    bodies = [load_dynamics(robot, "test", index) for index in range(ids.SPLIT_SIZES["test"])]
    physics = BatchPhysics(robot, bodies, threads=1)
    lanes, rng = np.arange(len(bodies)), np.random.default_rng(0)
    physics.start(lanes, [rng] * len(bodies))
    digest = hashlib.sha256(mujoco.__version__.encode())
    for _ in range(DIGEST_STEPS):
        actions = rng.uniform(-physics.action_limit, physics.action_limit, (len(lanes), len(physics.action_limit)))
        step = physics.step(actions)
        digest.update(step.states.astype("<f8").tobytes() + step.rewards.astype("<f8").tobytes())
    return digest.hexdigest()[:16]
