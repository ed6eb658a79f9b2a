"""The `spec` of an environment as text: Gymnasium keeps the arguments as they were given, NumPy's numbers too.

What is here: `PlainSpec`, the attribute `spec` of both kinds of environment. Gymnasium sets it when it has made one,
and whoever stores an environment as JSON, as Minari does, reads it. It must not know what the arguments mean.
"""

import dataclasses
import enum
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec


class PlainSpec:
    """An attribute that keeps a specification with its keyword arguments made plain; None where none is set."""

    def __get__(self, env: Any, owner: type) -> EnvSpec | None:
        """What was set; of the class itself None, as Gymnasium's."""
        return None if env is None else vars(env).get("spec")

    def __set__(self, env: Any, spec: EnvSpec | None) -> None:
        """Keep a copy with plain arguments; the one that was given stays as it is.

        Raises:
            ValueError: an argument is not what the id is registered with, so that the name would be of something else.
        """
        if spec is not None:
            _check_registered(spec)
        vars(env)["spec"] = None if spec is None else dataclasses.replace(spec, kwargs=_plain(spec.kwargs))


def _check_registered(spec: EnvSpec) -> None:
    known = gymnasium.registry.get(spec.id)
    for name, value in ({} if known is None else known.kwargs).items():
        if spec.kwargs.get(name, value) != value:
            raise ValueError(
                f"{spec.id} has {name} {value!r}, got {spec.kwargs[name]!r}: leave it out, or make an id with -v0, "
                "which takes it"
            )


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays, and enums, as what JSON can say; also inside of mappings and lists."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
