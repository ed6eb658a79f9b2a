"""TorchRL's reader of Minari datasets takes ours as they are: every row is the one that Minari has."""

import minari
import numpy as np
from torchrl.data.datasets.minari_data import MinariExperienceReplay

NAME = "dynagen/Hopper-RandDyn/test3-v0"


def test_torchrl_reads_what_minari_does(tiny_data, tmp_path):
    replay = MinariExperienceReplay(NAME, batch_size=4, load_from_local_minari=True, root=tmp_path / "torchrl")
    rows = replay[:]
    episodes = list(minari.load_dataset(NAME).iterate_episodes())
    assert len(replay) == sum(len(episode.actions) for episode in episodes)
    expected = {
        "observation": [episode.observations[:-1] for episode in episodes],
        "action": [episode.actions for episode in episodes],
        ("next", "observation"): [episode.observations[1:] for episode in episodes],
        ("next", "reward"): [episode.rewards[:, None] for episode in episodes],
        ("next", "terminated"): [episode.terminations[:, None] for episode in episodes],
        ("next", "truncated"): [episode.truncations[:, None] for episode in episodes],
    }
    for key, parts in expected.items():
        np.testing.assert_array_equal(rows[key].numpy(), np.concatenate(parts), err_msg=str(key))
    assert replay.sample()["observation"].shape == (4, 11)
