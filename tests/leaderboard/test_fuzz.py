"""The reader takes damaged submissions; `python -m tests.leaderboard.fuzz` gives it a hundred thousand of them."""

import shutil

from tests.leaderboard.fuzz import fuzz


def test_damaged_submissions_end_in_one_line(honest, tmp_path):
    shutil.copytree(honest, tmp_path / "mine")
    ends = fuzz(tmp_path / "mine", 1000, seed=1)
    assert sum(ends.values()) == 1000
    # every way out is taken, or the fuzzer does not reach what it should
    assert ends.keys() == {"refused by the reader", "read", "read, refused by the replay", "read and replayed"}
