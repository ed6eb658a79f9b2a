"""Multilayer perceptrons of one shape, side by side: what predictors and actor-critic agents are made of.

What is here: `Nets`, how a net's parameters are kept out of a loss, and how one net is made many and many one. Called
by the agents' files. It must not know what goes through a net.
"""

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor, nn


class Nets(nn.Module):
    """M multilayer perceptrons of one shape: one batched product a layer."""

    def __init__(
        self,
        members: int,
        sizes: Sequence[int],
        generator: torch.Generator,
        activation: Callable[[Tensor], Tensor] = nn.functional.relu,
    ) -> None:
        """`sizes`: of the input, the hidden layers and the output. Drawn uniform(±inputs^-1/2), as `trunk.linear`."""
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        self.activation = activation
        for inputs, outputs in itertools.pairwise(sizes):
            for kind, shape in ((self.weights, (outputs, inputs)), (self.biases, (1, outputs))):
                drawn = torch.rand(members, *shape, generator=generator)
                kind.append(nn.Parameter((2 * drawn - 1) * inputs**-0.5))

    def forward(self, x: Tensor) -> Tensor:
        """(M, R, inputs), or (R, inputs) for all members, → (M, R, outputs): rows R of each member's own."""
        if x.ndim == 2:
            x = x.expand(len(self.weights[0]), *x.shape)
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            # as `nn.Linear` multiplies: of products by a transposed matrix the rows come out alike wherever they stand
            x = torch.baddbmm(bias, self.activation(x) if layer else x, weight.mT)
        return x


@contextlib.contextmanager
def fixed(*modules: nn.Module) -> Iterator[None]:
    """Losses computed inside pass gradients through these modules, and give their parameters none."""
    parameters = [p for module in modules for p in module.parameters() if p.requires_grad]
    for parameter in parameters:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in parameters:
            parameter.requires_grad_(True)


@torch.no_grad()
def spread(few: nn.Module, many: nn.Module) -> None:
    """Each of G nets becomes M alike: `many` is of the shape of `few` with G · M nets, the M beside each other."""
    for one, copies in zip(few.parameters(), many.parameters(), strict=True):
        copies.copy_(one.repeat_interleave(len(copies) // len(one), dim=0))


@torch.no_grad()
def move_to_mean(few: nn.Module, many: nn.Module, share: float = 1.0) -> None:
    """The other way: each of G nets goes a share of the way to the mean of its M, parameter by parameter.

    With M = 1 it is how a slow copy follows a net.
    """
    for one, copies in zip(few.parameters(), many.parameters(), strict=True):
        one.lerp_(copies.view(len(one), -1, *copies.shape[1:]).mean(dim=1), share)
