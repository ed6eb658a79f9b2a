"""Checkpoints: all of it comes back, and no other file is taken for one."""

import contextlib
import dataclasses
import json
import os
import resource
import signal

import numpy as np
import pytest
import safetensors.torch
import torch

from agents.checkpoint import METADATA_KEY, load_checkpoint, save_checkpoint
from agents.learner import Learner
from dynagen_bench.datasets import WindowSampler
from tests.agents.samples import K, S, hopper_spec, random_dataset, tiny_config


@pytest.fixture
def learner(name) -> Learner:
    """Three steps into a run."""
    dataset = random_dataset()
    learner = Learner(
        name, tiny_config(name), dataclasses.replace(hopper_spec(), normalization=dataset.normalization()), 7
    )
    learner.sampler = WindowSampler(dataset, K, dataset.normalization())
    for _ in range(3):
        learner.update(learner.sampler)
    return learner


def test_saved_and_loaded_it_acts_the_same(learner, tmp_path):
    path = tmp_path / "run" / "last.safetensors"
    save_checkpoint(path, learner.checkpoint())
    found = load_checkpoint(path, agent=learner.name, robot="Hopper")
    assert (found.config, found.seed, found.step) == (learner.config, 7, 3)
    policies = learner.agent.policy(), found.build_agent().policy()
    rng = np.random.default_rng(0)
    for _ in range(8):
        observations, rewards = rng.normal(size=(5, S)), rng.normal(size=5)
        actions = [policy.predict(observations)[0] for policy in policies]
        assert np.array_equal(*actions)
        for policy in policies:
            if hasattr(policy, "observe"):  # who asks for no return need not be told
                policy.observe(rewards)
    assert os.listdir(path.parent) == ["last.safetensors"]


def test_a_restored_learner_goes_on_as_if_nothing_happened(learner, tmp_path):
    save_checkpoint(tmp_path / "last.safetensors", learner.checkpoint())
    other = Learner(learner.name, learner.config, learner.spec, learner.seed)
    other.restore(load_checkpoint(tmp_path / "last.safetensors"))
    for _ in range(4):
        assert learner.update(learner.sampler) == other.update(learner.sampler)
    for key, value in learner.checkpoint().parameters.items():
        assert torch.equal(value, other.checkpoint().parameters[key])


def test_parameters_of_other_code_are_one_line(learner):
    found = learner.checkpoint()
    renamed = {f"old_{name}": value for name, value in found.parameters.items()}
    other = dataclasses.replace(found, parameters=renamed)
    for use in (other.build_agent, lambda: learner.restore(other)):
        with pytest.raises(ValueError, match=f"are not those that this code's '{learner.name}' has") as caught:
            use()
        assert "\n" not in str(caught.value)


def test_the_same_checkpoint_is_the_same_file(learner, tmp_path):
    for file in ("a", "b"):
        save_checkpoint(tmp_path / file, learner.checkpoint())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@contextlib.contextmanager
def files_of_at_most(size):
    """No file can grow beyond `size` bytes, as on a disk that is almost full."""
    handler, limits = signal.signal(signal.SIGXFSZ, signal.SIG_IGN), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_leaves_the_checkpoint_that_was_there(learner, tmp_path):
    path = tmp_path / "last.safetensors"
    save_checkpoint(path, learner.checkpoint())
    before = path.read_bytes()
    learner.update(learner.sampler)
    with (
        files_of_at_most(len(before) // 2),
        pytest.raises(OSError, match=r"could not be written .*: make room") as caught,
    ):
        save_checkpoint(path, learner.checkpoint())
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["last.safetensors"]


def write(path, metadata, tensors=None):
    safetensors.torch.save_file(tensors or {"x": torch.zeros(1)}, path, metadata=metadata)


def test_other_files_are_refused_in_one_line(learner, tmp_path):
    path = tmp_path / "last.safetensors"
    save_checkpoint(path, learner.checkpoint())
    with safetensors.safe_open(path, framework="pt") as file:
        good = json.loads(file.metadata()[METADATA_KEY])
    text = tmp_path / "text"
    text.write_text("not a checkpoint")
    write(tmp_path / "bare", None)
    write(tmp_path / "future", {METADATA_KEY: json.dumps(good | {"format_version": 2})})
    write(tmp_path / "empty", {METADATA_KEY: json.dumps(good)})
    write(tmp_path / "odd", {METADATA_KEY: json.dumps(good | {"agent": "nobody"})})
    cases = [
        ({"path": tmp_path / "none"}, FileNotFoundError, "no checkpoint at"),
        ({"path": text}, ValueError, "is no checkpoint"),
        ({"path": tmp_path / "bare"}, ValueError, "is no checkpoint of an agent"),
        ({"path": tmp_path / "future"}, ValueError, "has format version 2, this code reads 1"),
        ({"path": tmp_path / "empty"}, ValueError, "is no whole checkpoint"),
        ({"path": tmp_path / "odd"}, ValueError, "is no whole checkpoint"),
        ({"path": path, "agent": "focal"}, ValueError, f"is of agent '{learner.name}', not 'focal'"),
        ({"path": path, "robot": "Ant"}, ValueError, "is of robot 'Hopper', not 'Ant'"),
    ]
    for arguments, error, message in cases:
        with pytest.raises(error, match=message) as caught:
            load_checkpoint(**arguments)
        assert "\n" not in str(caught.value)
