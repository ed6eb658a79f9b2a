"""Verdicts on the paper's claims, by hand."""

import numpy as np
import pytest

from leaderboard.entries import Entry
from leaderboard.statistics import Estimate
from results import tables
from results.claims import Evidence, claims, final_scores
from results.kept import Errors, keep, kept_runs
from tests.evaluation.samples import submission


def entry(slug, means, **fields):
    return Entry(slug, submission({"Hopper": means}, **fields), "replayed")


def verdicts(entries=(), errors=(), groups=None):
    return {claim.text: claim for claim in claims(entries, errors, groups or {})}


BETTER, CLONING = (
    "Predicting next states makes a Decision Transformer act better",
    "Conditioning on returns acts better than cloning",
)


def test_nothing_is_claimed_of_what_has_not_been_run():
    assert {claim.verdict for claim in verdicts().values()} == {"not run"}


def test_a_claim_holds_where_every_run_is_better():
    dadt, dt = entry("dadt-zero-shot-last", [100.0, 110.0, 120.0]), entry("dt-zero-shot-last", [60.0, 70.0, 80.0])
    (evidence,) = verdicts([dadt, dt])[BETTER].evidence
    assert evidence == Evidence("DADT > DT", Estimate(1.0, (1.0, 1.0)), ("Hopper",), (3, 3))
    assert verdicts([dadt, dt])[BETTER].verdict == "holds"
    assert "1.00 [1.00, 1.00] (Hopper; 3 runs each)" in tables.verdicts([verdicts([dadt, dt])[BETTER]])
    swapped = [entry("dadt-zero-shot-last", [60.0, 70.0]), entry("dt-zero-shot-last", [100.0, 110.0])]
    assert verdicts(swapped)[BETTER].verdict == "does not hold"


def test_the_runs_of_both_sides_are_told_where_they_differ():
    dadt, dt = entry("dadt-zero-shot-last", [100.0, 110.0, 120.0]), entry("dt-zero-shot-last", [60.0, 70.0])
    assert "(Hopper; 3 and 2 runs)" in tables.verdicts([verdicts([dadt, dt])[BETTER]])


def test_runs_that_are_mixed_decide_nothing():
    mixed = [entry("dadt-zero-shot-last", [60.0, 100.0]), entry("dt-zero-shot-last", [70.0, 90.0])]
    found = verdicts(mixed)[BETTER]
    assert (found.verdict, found.evidence[0].estimate.value) == ("undecided", 0.5)


def test_one_run_decides_nothing():
    one = [entry("dadt-zero-shot-last", [100.0]), entry("dt-zero-shot-last", [50.0, 60.0])]
    assert verdicts(one)[BETTER].verdict == "undecided"


def test_a_claim_of_two_comparisons_needs_both():
    dt, dadt = entry("dt-zero-shot-last", [100.0, 110.0]), entry("dadt-zero-shot-last", [100.0, 110.0])
    cloning = entry("transformer-bc-zero-shot-last", [20.0, 30.0])
    assert verdicts([dt, dadt, cloning])[CLONING].verdict == "holds"
    assert verdicts([dt, cloning])[CLONING].verdict == "not run"
    worse = entry("dadt-zero-shot-last", [0.0, 10.0])
    assert verdicts([dt, worse, cloning])[CLONING].verdict == "does not hold"


def test_the_best_checkpoint_is_no_evidence():
    best = [entry(f"{name}-zero-shot-best", [100.0, 110.0], checkpoint="best") for name in ("dadt", "dt")]
    assert verdicts(best)[BETTER].verdict == "not run"


def test_less_error_is_better():
    errors = [Errors("dadt", "Hopper", np.full((2, 5), 0.01)), Errors("dt_plus", "Hopper", np.full((2, 5), 0.3))]
    found = verdicts(errors=errors)["Joint training predicts next states better than a head on a frozen DT"]
    assert (found.verdict, found.evidence[0].what) == ("holds", "DADT > DT+")
    assert verdicts(errors=errors)["A transformer predicts next states best"].verdict == "not run"


@pytest.fixture
def weights(trained, tmp_path):
    """Makes kept runs of the sweep over λ: `weights({0.01: [scores], ...})`."""

    def make(scores):
        for weight, of in scores.items():
            runs = [trained("dadt", seed, score=score, next_state_weight=weight) for seed, score in enumerate(of)]
            keep(runs, "next-state-weight", tmp_path / "kept")
        return {"next-state-weight": kept_runs("next-state-weight", tmp_path / "kept")}

    return make


ROBUST = "The weight of the next state's error hardly matters"


def test_a_weight_that_matters_is_found(weights):
    groups = weights({0.01: [10.0, 11.0, 12.0], 1.0: [50.0, 51.0, 52.0], 0.1: [30.0, 31.0, 32.0]})
    assert final_scores(groups["next-state-weight"], "next_state_weight")["0.1"]["Hopper"].tolist() == [
        [30],
        [31],
        [32],
    ]
    found = verdicts(groups=groups)[ROBUST]
    assert (found.verdict, found.evidence[0].what) == ("does not hold", "λ = 1.0 > λ = 0.01")


def test_few_mixed_runs_do_not_show_that_a_weight_does_not_matter(weights):
    groups = weights({0.01: [10.0, 50.0, 30.0], 1.0: [11.0, 49.0, 31.0]})
    assert verdicts(groups=groups)[ROBUST].verdict == "undecided"


def test_the_same_scores_show_that_a_weight_does_not_matter(weights):
    groups = weights({0.01: [30.0, 30.0, 30.0], 1.0: [30.0, 30.0, 30.0]})
    assert verdicts(groups=groups)[ROBUST].verdict == "holds"
