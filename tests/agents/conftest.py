"""Settings of the agents' tests: one thread, and the contract's tests once for each sequence agent."""

import pytest
import torch

from tests.agents.samples import SEQUENCE_AGENTS, TRANSFORMERS, stages

torch.set_num_threads(1)


@pytest.fixture(params=SEQUENCE_AGENTS)
def name(request) -> str:
    """Name of an agent that is trained on windows."""
    return request.param


@pytest.fixture(params=TRANSFORMERS)
def transformer(request) -> str:
    """Name of one of them that is a transformer."""
    return request.param


@pytest.fixture(params=[stage for stage in stages() if stage[0] in TRANSFORMERS], ids=lambda at: f"{at[0]}-step{at[1]}")
def transformer_stage(request) -> tuple[str, int]:
    """A transformer's name and a step, in each of the phases that it learns in."""
    return request.param


@pytest.fixture(params=stages(), ids=lambda stage: f"{stage[0]}-step{stage[1]}")
def stage(request) -> tuple[str, int]:
    """An agent's name and a step, in each of the phases that it learns in."""
    return request.param
