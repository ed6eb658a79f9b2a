"""The yardstick of training speed: Decision Transformer written plainly, in eager float32.

What is here: the network of the paper's Table 6 from PyTorch's stock layers, as one-file implementations write it:
GELU, nn.MultiheadAttention, nn.Dropout, AdamW and a clipped gradient. The benchmark of training compares ours with it.
"""

import torch
from torch import Tensor, nn

from agents.interface import History
from dynagen_bench.datasets import Windows

D, LAYERS, DROPOUT = 128, 3, 0.1


class PlainBlock(nn.Module):
    """Attention and a perceptron, each normalised before and added after."""

    def __init__(self) -> None:
        super().__init__()
        self.norm1, self.norm2, self.drop = nn.LayerNorm(D), nn.LayerNorm(D), nn.Dropout(DROPOUT)
        self.attention = nn.MultiheadAttention(D, 1, DROPOUT, batch_first=True)
        self.perceptron = nn.Sequential(nn.Linear(D, 4 * D), nn.GELU(), nn.Linear(4 * D, D), nn.Dropout(DROPOUT))

    def forward(self, x: Tensor, later: Tensor, padding: Tensor) -> Tensor:
        """(B, T, D) → (B, T, D)."""
        h = self.norm1(x)
        h, _ = self.attention(h, h, h, attn_mask=later, key_padding_mask=padding, need_weights=False)
        x = x + self.drop(h)
        return x + self.perceptron(self.norm2(x))


class PlainDT(nn.Module):
    """Decision Transformer and its optimiser."""

    def __init__(self, state_size: int, action_size: int, context: int) -> None:
        super().__init__()
        self.inputs = nn.ModuleList(nn.Linear(size, D) for size in (1, state_size, action_size))
        self.time, self.norm, self.drop = nn.Embedding(200, D), nn.LayerNorm(D), nn.Dropout(DROPOUT)
        self.blocks = nn.ModuleList(PlainBlock() for _ in range(LAYERS))
        self.last_norm, self.head = nn.LayerNorm(D), nn.Sequential(nn.Linear(D, action_size), nn.Tanh())
        length = 3 * context
        self.register_buffer("later", torch.full((length, length), -torch.inf).triu(1))
        self.optimizer = torch.optim.AdamW(self.parameters(), lr=3e-5, betas=(0.9, 0.99), weight_decay=1e-4)

    def forward(self, history: History) -> Tensor:
        """Actions (B, K, A)."""
        given = (history.returns_to_go[..., None] / 1000, history.observations, history.actions)
        time = self.time(history.timesteps)
        x = torch.stack([embed(value) + time for embed, value in zip(self.inputs, given, strict=True)], dim=2)
        x = self.drop(self.norm(x.flatten(1, 2)))
        padding = (~history.mask).repeat_interleave(3, dim=1)
        padding = padding.float() * -1e30  # not -inf: left padding leaves its queries nothing else to see
        for block in self.blocks:
            x = block(x, self.later, padding)
        out: Tensor = self.head(self.last_norm(x)[:, 1::3])
        return out

    def update(self, windows: Windows) -> float:
        """One gradient step; returns the loss."""
        history = History.of(windows)
        loss = (self(history) - history.actions)[history.mask].square().mean()
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters(), 1.0)
        self.optimizer.step()
        return loss.item()
