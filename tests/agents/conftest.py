"""Settings of the agents' tests: one thread, and every test once for each agent."""

import pytest
import torch

from agents import AGENTS

torch.set_num_threads(1)


@pytest.fixture(params=AGENTS)
def name(request) -> str:
    """An agent's name."""
    return request.param
