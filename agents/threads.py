"""How many processor threads torch takes.

What is here: `use_threads`. Called by the command lines, before they compute anything. It must not know what for.
"""

import torch

from dynagen_bench import ids


def use_threads(threads: int) -> None:
    """Let torch compute with so many threads; 0 leaves the number to torch. Raises ValueError for one below 0."""
    if count := ids.check_count("threads", threads, least=0):
        torch.set_num_threads(count)
