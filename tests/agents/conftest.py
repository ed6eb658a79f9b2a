"""Settings of the agents' tests: one thread, and the contract's tests once for each sequence agent."""

import pytest
import torch

from tests.agents.samples import SEQUENCE_AGENTS, stages

torch.set_num_threads(1)


@pytest.fixture(params=SEQUENCE_AGENTS)
def name(request) -> str:
    """Name of an agent that is trained on windows."""
    return request.param


@pytest.fixture(params=stages(), ids=lambda stage: f"{stage[0]}-step{stage[1]}")
def stage(request) -> tuple[str, int]:
    """An agent's name and a step, in each of the phases that it learns in."""
    return request.param
