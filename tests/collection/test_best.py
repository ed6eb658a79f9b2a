"""The best snapshot is the one that returns most, in environments that a user makes."""

import gymnasium
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.collection.best import CHOICE_SEED, TRIALS, best_snapshot
from dynagen_bench.collection.episodes import reset_seed
from dynagen_bench.collection.policies import load_policies, policy_file


@pytest.mark.parametrize("label", ["train5", "test3"])
def test_the_best_returns_most_without_noise(label, tiny_policies):
    name = ids.parse_label("Hopper", label)
    snapshots = load_policies(policy_file(name, tiny_policies))[0]
    means = []
    for number, policy in enumerate(snapshots.values()):
        returns = []
        for trial in range(TRIALS):
            env = gymnasium.make(name.env_id)
            observation, _ = env.reset(seed=reset_seed(name, TRIALS * number + trial, seed=CHOICE_SEED))
            total, over = 0.0, False
            while not over:
                action = policy.act(observation[None], np.ones(3), None)[0].astype(np.float32)
                observation, reward, terminated, truncated, _ = env.step(action)
                total, over = total + reward, terminated or truncated
            returns.append(total)
        means.append(np.mean(returns))
    assert best_snapshot(name, snapshots) == list(snapshots)[int(np.argmax(means))]
