"""Bins of equal counts, and numbers to tokens and back."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agents.trajectory_transformer.discretization import Discretizer, quantile_thresholds

ROWS = arrays(np.float32, st.tuples(st.integers(1, 40), st.integers(1, 3)), elements=st.floats(-1e6, 1e6, width=32))


def fitted(rows, bins: int = 4) -> Discretizer:
    discretizer = Discretizer(rows.shape[1], bins)
    discretizer.fit(rows)
    return discretizer


def test_thresholds_by_hand():
    rows = np.array([[5, 1], [3, 1], [1, 1], [4, 1], [2, 1], [6, 9], [7, 9]], np.float32)
    assert quantile_thresholds(rows, 3).tolist() == [[1, 3, 5, 7], [1, 1, 1, 9]]
    discretizer = fitted(rows, 3)
    numbers = torch.tensor([[0.0, 0.0], [1, 1], [2.9, 5], [3, 9], [5, 10], [8, 10]])
    assert discretizer.encode(numbers).tolist() == [[0, 0], [0, 2], [0, 2], [1, 2], [2, 2], [2, 2]]
    assert discretizer.decode(torch.tensor([[0, 0], [1, 2], [2, 3]])).tolist() == [[2, 1], [4, 5], [6, 5]]
    probabilities = torch.tensor([0.5, 0.25, 0.25, 0.0])
    assert discretizer.expect(probabilities, 0).item() == 0.5 * 2 + 0.25 * 4 + 0.25 * 6
    assert discretizer.expect(torch.tensor([0.5, 0.0, 0.0, 0.5]), 0).item() == 1.0  # stop counts as 0


@given(st.integers(1, 60), st.integers(2, 12), st.integers(0, 100))
def test_bins_have_equal_counts(count, bins, seed):
    rows = np.random.default_rng(seed).permutation(count).astype(np.float32)[:, None]
    tokens = fitted(rows, bins).encode(torch.from_numpy(rows))
    counts = torch.bincount(tokens[:, 0], minlength=bins)
    assert counts.sum() == count
    assert counts.max() - counts.min() <= 1


@given(ROWS)
def test_tokens_grow_with_numbers_and_numbers_with_tokens(rows):
    discretizer = fitted(rows)
    tokens = discretizer.encode(torch.from_numpy(np.sort(rows, axis=0)))
    assert (tokens.diff(dim=0) >= 0).all()
    assert 0 <= tokens.min() <= tokens.max() <= 3
    assert (discretizer.decode(tokens).diff(dim=0) >= 0).all()


@given(ROWS)
def test_what_is_decoded_is_in_the_bin_that_it_was_encoded_in(rows):
    discretizer, numbers = fitted(rows), torch.from_numpy(rows)
    tokens = discretizer.encode(numbers)
    decoded = discretizer.decode(tokens)
    assert torch.equal(discretizer.encode(decoded), tokens)
    widths = discretizer.thresholds[:, 1:] - discretizer.thresholds[:, :-1]
    assert ((decoded - numbers).abs() <= widths[torch.arange(rows.shape[1]), tokens]).all()


def test_some_dimensions_alone_are_as_among_all():
    rows = np.random.default_rng(0).normal(size=(2, 50, 5)).astype(np.float32)
    discretizer, numbers = fitted(rows[0], 10), torch.from_numpy(rows)
    tokens = discretizer.encode(numbers)
    assert torch.equal(discretizer.encode(numbers[..., 2:4], first=2), tokens[..., 2:4])
    assert torch.equal(discretizer.decode(tokens[..., 2:4], first=2), discretizer.decode(tokens)[..., 2:4])


def test_thresholds_are_in_the_state_and_no_gradient_moves_them():
    discretizer = fitted(np.arange(10, dtype=np.float32)[:, None])
    again = Discretizer(1, 4)
    again.load_state_dict(dict(discretizer.named_parameters()))
    assert torch.equal(again.thresholds, discretizer.thresholds)
    assert not again.thresholds.requires_grad


def test_what_cannot_be_fitted_or_is_not_is_said_in_one_line():
    with pytest.raises(RuntimeError, match="no thresholds: fit it to training data"):
        Discretizer(2, 4).encode(torch.zeros(3, 2))
    for rows in (np.zeros((0, 2), np.float32), np.full((3, 2), np.nan, np.float32)):
        with pytest.raises(ValueError, match=r"rows to make bins of, .*: give finite numbers"):
            quantile_thresholds(rows, 4)
