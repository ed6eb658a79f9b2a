"""Stored behaviour policies: small actors that are executed the same everywhere.

What is here: `BehaviourPolicy` (one snapshot, in numpy) and the file of one dynamics' snapshots. Called by the SAC run,
which writes it, and by the episodes, which run it. It must not know JAX or how the policy was trained: rebuilding the
data needs none of that.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.whole import whole_file

ACTION_STEP: Final = 2.0**-12
"""Actions are rounded to multiples of this. Processors differ by about 1e-15 in a float64 policy; rounding to float32
alone would let a few of the tens of millions of actions flip, and a flipped bit grows into another episode."""

LOG_STD_RANGE: Final = (-20.0, 2.0)
"""As sbx clips it (sbx/common/policies.py, SquashedGaussianActor)."""

LAYERS: Final = ("hidden0", "hidden1", "mean", "log_std")

METADATA_KEY: Final = "dynagen-policies"

POLICY_FOLDER: Final = Path(__file__).parent / "policies"
"""The committed policies, `{robot}/{label}.safetensors`, in the package."""


@dataclasses.dataclass(frozen=True)
class BehaviourPolicy:
    """A tanh-Gaussian actor of two hidden layers: stored in float16, executed in float64.

    Attributes:
        weights: layer name → (inputs, outputs) float16.
        biases: layer name → (outputs,) float16.
    """

    weights: Mapping[str, NDArray[np.float16]]
    biases: Mapping[str, NDArray[np.float16]]

    def act(
        self, observations: NDArray[np.floating[Any]], limit: NDArray[np.float64], noise: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Actions (N, A) for observations (N, S), multiples of `ACTION_STEP`.

        Args:
            observations: (N, S), as the environment gives them.
            limit: (A,), the action space is ± this.
            noise: (N, A) standard normal draws; None gives the deterministic action.
        """
        hidden = np.asarray(observations, dtype=np.float64)
        for layer in LAYERS[:2]:
            hidden = np.maximum(self._linear(layer, hidden), 0.0)
        action = self._linear("mean", hidden)
        if noise is not None:
            action = action + np.exp(np.clip(self._linear("log_std", hidden), *LOG_STD_RANGE)) * noise
        rounded: NDArray[np.float64] = np.round(np.tanh(action) * limit / ACTION_STEP) * ACTION_STEP
        return rounded

    def _linear(self, layer: str, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        product: NDArray[np.float64] = inputs @ self.weights[layer].astype(np.float64)
        return product + self.biases[layer].astype(np.float64)

    def content_hash(self) -> str:
        """SHA-256 of the weights, hexadecimal: what each episode made by this policy carries."""
        digest = hashlib.sha256()
        for layer in LAYERS:
            for array in (self.weights[layer], self.biases[layer]):
                digest.update(str(array.shape).encode() + np.ascontiguousarray(array, dtype="<f2").tobytes())
        return digest.hexdigest()


def policy_file(name: ids.DynamicsId, folder: Path = POLICY_FOLDER) -> Path:
    """Where the snapshots of one dynamics are kept."""
    return folder / name.robot / f"{name.label}.safetensors"


def save_policies(path: Path, snapshots: Mapping[int, BehaviourPolicy], metadata: Mapping[str, Any]) -> None:
    """Write the snapshots (environment steps → policy) of one dynamics in one file: whole, or not at all.

    The metadata is one JSON text, because safetensors writes several in no fixed order: same content, same bytes.
    """
    tensors = {}
    for step, policy in snapshots.items():
        for layer in LAYERS:
            tensors[f"{step:08d}/{layer}/weight"] = np.ascontiguousarray(policy.weights[layer], dtype=np.float16)
            tensors[f"{step:08d}/{layer}/bias"] = np.ascontiguousarray(policy.biases[layer], dtype=np.float16)
    with whole_file(path) as unfinished:
        safetensors.numpy.save_file(tensors, unfinished, metadata={METADATA_KEY: json.dumps(metadata)})


def load_policies(path: Path) -> tuple[dict[int, BehaviourPolicy], dict[str, Any]]:
    """Read what `save_policies` wrote: snapshots in order of their steps, and the metadata.

    Raises:
        FileNotFoundError: there is no such file; the message says how it is made.
        ValueError: the file holds something else.
    """
    if not path.is_file():
        robot, label = path.parent.name, path.stem
        raise FileNotFoundError(f"no behaviour policies at {path}: train them with `dynagen collect {robot} {label}`")
    snapshots: dict[int, BehaviourPolicy] = {}
    try:
        with safetensors.safe_open(path, framework="numpy") as file:
            metadata: dict[str, Any] = json.loads((file.metadata() or {})[METADATA_KEY])
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118, safe_open is no mapping
        for step in sorted({key.split("/")[0] for key in tensors}):
            weights = {layer: tensors[f"{step}/{layer}/weight"] for layer in LAYERS}
            biases = {layer: tensors[f"{step}/{layer}/bias"] for layer in LAYERS}
            snapshots[int(step)] = BehaviourPolicy(weights, biases)
    except (KeyError, ValueError, safetensors.SafetensorError) as error:
        raise ValueError(f"{path} holds no behaviour policies ({error}): restore it from the repository") from error
    return snapshots, metadata
