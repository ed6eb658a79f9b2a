"""How many processor threads torch takes.

What is here: `use_threads`. Called by the command lines, before they compute anything. It must not know what for.
"""

import torch


def use_threads(threads: int) -> None:
    """Let torch compute with so many threads; 0 leaves the number to torch. Raises ValueError for one below 0."""
    if threads < 0:
        raise ValueError(f"threads is {threads}: give a whole number from 0 on")
    if threads:
        torch.set_num_threads(threads)
