"""The trunk: against an independent GPT-2."""

import numpy as np
import pytest
import torch
from transformers import GPT2Config, GPT2Model

from agents.config import TransformerConfig
from agents.trunk import Trunk, linear


def gpt2_with_weights_of(trunk: Trunk, config: TransformerConfig) -> GPT2Model:
    """Hugging Face's GPT-2 with a trunk's weights and no position embeddings, as the original DT uses it."""
    gpt2 = GPT2Model(
        GPT2Config(
            vocab_size=1,
            n_embd=config.embedding,
            n_layer=config.layers,
            n_head=config.heads,
            n_inner=4 * config.embedding,
            activation_function="relu",
        )
    ).eval()
    state = {"wte.weight": gpt2.wte.weight, "wpe.weight": torch.zeros_like(gpt2.wpe.weight)}
    names = {"norm1": "ln_1", "attention.qkv": "attn.c_attn", "attention.out": "attn.c_proj"}
    names |= {"norm2": "ln_2", "widen": "mlp.c_fc", "narrow": "mlp.c_proj"}
    for i in range(config.layers):
        for ours, theirs in names.items():
            module = trunk.get_submodule(f"blocks.{i}.{ours}")
            transposed = isinstance(module, torch.nn.Linear)  # their Conv1D keeps (inputs, outputs)
            state[f"h.{i}.{theirs}.weight"] = module.weight.T if transposed else module.weight
            state[f"h.{i}.{theirs}.bias"] = module.bias
    state |= {"ln_f.weight": trunk.norm.weight, "ln_f.bias": trunk.norm.bias}
    gpt2.load_state_dict(state)
    return gpt2


@pytest.mark.parametrize(("layers", "heads", "embedding"), [(3, 1, 128), (2, 4, 32)])
def test_agrees_with_hugging_face_gpt2(layers, heads, embedding):
    config = TransformerConfig(layers=layers, heads=heads, embedding=embedding)
    generator = torch.Generator().manual_seed(0)
    trunk = Trunk(config, generator)
    with torch.no_grad():  # away from GPT-2's tiny first weights, so that every part matters
        for parameter in trunk.parameters():
            parameter.add_(torch.randn(parameter.shape, generator=generator) * 0.1)
    tokens = torch.randn(4, 60, embedding, generator=generator)
    mask = torch.arange(60) >= torch.tensor([0, 1, 30, 59])[:, None]
    with torch.no_grad():
        ours = trunk(tokens, mask)
        theirs = gpt2_with_weights_of(trunk, config)(inputs_embeds=tokens, attention_mask=mask.long()).last_hidden_state
    assert torch.isfinite(ours).all()
    assert (ours - theirs)[mask].abs().max() < 1e-5


def test_first_weights_are_gpt2s():
    trunk = Trunk(TransformerConfig(), torch.Generator().manual_seed(0))
    for name, parameter in trunk.named_parameters():
        if "norm" in name:
            assert (parameter == (1.0 if name.endswith("weight") else 0.0)).all()
        elif name.endswith("bias"):
            assert (parameter == 0).all()
        else:
            assert parameter.std().item() == pytest.approx(0.02, rel=0.03)


def test_linear_is_pytorchs_by_default():
    layer = linear(64, 500, torch.Generator().manual_seed(0))
    for parameter in layer.parameters():
        assert parameter.abs().max() <= 1 / 8
        assert parameter.std().item() == pytest.approx(1 / 8 / np.sqrt(3), rel=0.1)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_asked_for_some_tokens_it_gives_what_it_gives_for_all(dtype):
    trunk = Trunk(TransformerConfig(heads=2, embedding=32), torch.Generator().manual_seed(0))
    tokens = torch.randn(4, 9, 32, generator=torch.Generator().manual_seed(1))
    mask = torch.arange(9) >= torch.tensor([0, 1, 5, 8])[:, None]
    queries = torch.tensor([1, 4, 8])
    with torch.no_grad():
        whole, part = trunk(tokens, mask, dtype=dtype), trunk(tokens, mask, queries=queries, dtype=dtype)
    assert part.shape == (4, 3, 32)
    torch.testing.assert_close(part, whole[:, queries], rtol=1e-5, atol=1e-5 if dtype == torch.float32 else 2e-2)


def test_all_of_it_is_on_the_device_of_its_parameters():
    trunk = Trunk(TransformerConfig(embedding=32), torch.Generator().manual_seed(0)).to("meta")
    out = trunk(torch.empty(4, 9, 32, device="meta"), torch.ones(4, 9, dtype=torch.bool, device="meta"))
    assert out.device.type == "meta"
    out.sum().backward()
    assert all(parameter.grad.device.type == "meta" for parameter in trunk.parameters())
