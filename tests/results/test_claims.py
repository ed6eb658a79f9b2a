"""Verdicts on the paper's claims, by hand."""

import dataclasses
import json
import re

import numpy as np
import pytest

from leaderboard.comparison import Comparison
from leaderboard.entries import Entry
from leaderboard.statistics import Estimate
from results import tables
from results.claims import _robust, claims, final_scores, spread_by_chance
from results.kept import Errors, keep, kept_runs, kept_scores
from tests.evaluation.samples import submission


def entry(slug, means, **fields):
    return Entry(slug, submission({"Hopper": means}, **fields), "replayed")


def verdicts(entries=(), errors=(), low=None, weights=None):
    return {claim.text: claim for claim in claims(entries, errors, low or {}, weights or {})}


BETTER, CLONING = (
    "Predicting next states makes a Decision Transformer act better",
    "Conditioning on returns acts better than cloning",
)


def test_nothing_is_claimed_of_what_has_not_been_run():
    assert {claim.verdict for claim in verdicts().values()} == {"not run"}


def test_a_claim_holds_where_every_run_is_better():
    dadt, dt = entry("dadt-zero-shot-last", [100.0, 110.0, 120.0]), entry("dt-zero-shot-last", [60.0, 70.0, 80.0])
    (evidence,) = verdicts([dadt, dt])[BETTER].evidence
    always = Estimate(1.0, (1.0, 1.0))
    assert evidence == Comparison("DADT > DT", always, ("Hopper",), (3, 3), (always,))
    assert verdicts([dadt, dt])[BETTER].verdict == "holds"
    assert "1.00 [1.00, 1.00] (Hopper; 3 runs each)" in tables.verdicts([verdicts([dadt, dt])[BETTER]])
    swapped = [
        entry("dadt-zero-shot-last", [60.0, 70.0, 80.0]),
        entry("dt-zero-shot-last", [100.0, 110.0, 120.0]),
    ]
    assert verdicts(swapped)[BETTER].verdict == "does not hold"


def on_robots(slug, means):
    return Entry(slug, submission(means), "replayed")


def test_a_robot_that_says_the_opposite_leaves_a_claim_undecided():
    high, low = [100.0, 110.0, 120.0], [60.0, 70.0, 80.0]
    dadt = on_robots("dadt-zero-shot-last", {"Walker": high, "Hopper": high, "Ant": low})
    dt = on_robots("dt-zero-shot-last", {"Walker": low, "Hopper": low, "Ant": high})
    found = verdicts([dadt, dt])[BETTER]
    (evidence,) = found.evidence
    # of each three runs: all above on two robots, all below on the third, so that no resample is anything else
    assert evidence.estimate.value == pytest.approx(2 / 3)
    assert evidence.estimate.interval[0] > 0.5
    assert [one.value for one in evidence.each] == [1.0, 1.0, 0.0]
    assert found.verdict == "undecided"
    assert "0.67 [0.67, 0.67] (Walker 1.00, Hopper 1.00, Ant 0.00; at least 3 runs each)" in tables.verdicts([found])
    equal = on_robots("dt-zero-shot-last", {"Walker": low, "Hopper": low, "Ant": [50.0, 70.0, 90.0]})
    assert verdicts([dadt, equal])[BETTER].verdict == "holds"  # undecided on a robot is no contradiction


def test_the_runs_of_both_sides_are_told_where_they_differ():
    dadt, dt = entry("dadt-zero-shot-last", [100.0, 110.0, 120.0]), entry("dt-zero-shot-last", [60.0, 70.0])
    assert "(Hopper; 3 and 2 runs)" in tables.verdicts([verdicts([dadt, dt])[BETTER]])


def test_runs_that_are_mixed_decide_nothing():
    mixed = [
        entry("dadt-zero-shot-last", [60.0, 80.0, 100.0]),
        entry("dt-zero-shot-last", [70.0, 80.0, 90.0]),
    ]
    found = verdicts(mixed)[BETTER]
    assert (found.verdict, found.evidence[0].estimate.value) == ("undecided", 0.5)


@pytest.mark.parametrize("runs", [1, 2])
def test_one_run_or_two_decide_nothing(runs):
    few = [entry("dadt-zero-shot-last", [100.0, 110.0][:runs]), entry("dt-zero-shot-last", [50.0, 60.0, 70.0])]
    assert verdicts(few)[BETTER].verdict == "undecided"


def test_what_nobody_has_replayed_is_no_evidence():
    dadt, dt = entry("dadt-zero-shot-last", [100.0, 110.0, 120.0]), entry("dt-zero-shot-last", [60.0, 70.0, 80.0])
    sent_in = dataclasses.replace(dadt, label="self-reported")
    assert verdicts([sent_in, dt])[BETTER].verdict == "not run"
    assert "55.00" in tables.scores([dadt, dt], "zero-shot")  # half the mean return
    assert "55.00" not in tables.scores([sent_in, dt], "zero-shot")


def test_a_claim_of_two_comparisons_needs_both():
    dt, dadt = (entry(f"{name}-zero-shot-last", [100.0, 110.0, 120.0]) for name in ("dt", "dadt"))
    cloning = entry("transformer-bc-zero-shot-last", [20.0, 30.0, 40.0])
    assert verdicts([dt, dadt, cloning])[CLONING].verdict == "holds"
    assert verdicts([dt, cloning])[CLONING].verdict == "not run"
    worse = entry("dadt-zero-shot-last", [0.0, 10.0, 15.0])
    assert verdicts([dt, worse, cloning])[CLONING].verdict == "does not hold"


def test_the_best_checkpoint_is_no_evidence():
    best = [entry(f"{name}-zero-shot-best", [100.0, 110.0], checkpoint="best") for name in ("dadt", "dt")]
    assert verdicts(best)[BETTER].verdict == "not run"


def test_less_error_is_better():
    errors = [Errors("dadt", "Hopper", np.full((3, 5), 0.01)), Errors("dt_plus", "Hopper", np.full((3, 5), 0.3))]
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
        return final_scores(kept_runs("next-state-weight", tmp_path / "kept"), "next_state_weight")

    return make


ROBUST = "The weight of the next state's error hardly matters"


def test_a_weight_that_matters_is_found(weights):
    groups = weights({0.01: [10.0, 11.0, 12.0], 1.0: [50.0, 51.0, 52.0], 0.1: [30.0, 31.0, 32.0]})
    assert groups["0.1"]["Hopper"].tolist() == [[30], [31], [32]]
    found = verdicts(weights=groups)[ROBUST]
    # 6 of the 1,680 ways to deal nine runs to three values spread them as wide: 0.0036
    assert found.verdict == "does not hold"
    assert found.evidence[0].what == "best − worst of 3 values of λ (1.0, 0.01), points"
    # each of the three values' means is of three runs that lie two points apart at most
    assert found.evidence[0].estimate == Estimate(40.0, (pytest.approx(38.7, abs=0.1), pytest.approx(41.3, abs=0.1)))
    line = tables.verdicts([found])
    assert re.search(r"40\.00 \[38\.\d+, 41\.\d+\], as wide by chance p = 0\.00[2-6] \(Hopper; 3 runs each\)", line)


def test_two_runs_of_a_weight_decide_nothing(weights):
    far = {0.01: [10.0, 11.0, 12.0], 1.0: [50.0, 51.0, 52.0], 0.1: [30.0, 31.0], 0.5: [20.0, 21.0, 20.0]}
    found = verdicts(weights=weights(far))[ROBUST]
    assert found.verdict == "undecided"
    assert "(Hopper; 2 to 3 runs)" in tables.verdicts([found])  # and the best and the worst have three


def test_of_one_run_of_a_weight_no_interval_is_told(weights):
    found = verdicts(weights=weights({0.01: [10.0], 1.0: [50.0, 51.0, 52.0]}))[ROBUST]
    assert found.verdict == "undecided"
    assert found.evidence[0].estimate == Estimate(41.0, None)
    assert re.search(r"points: 41\.00, as wide by chance p = 0\.\d+ \(Hopper; 1 to 3 runs\)", tables.verdicts([found]))


def test_low_quality_scores_are_compared_in_the_same_dynamics(trained, tmp_path):
    """DADT's runs are better in three of the five dynamics, and worse in the mean."""
    for agent, means in (("dadt", [60, 60, 60, 10, 10]), ("dt", [50, 50, 50, 90, 90])):
        for seed in range(3):
            run = trained(agent, seed, score=0.0, settings={"quality": 0.3})
            result = json.loads((run / "evaluation.json").read_text())
            result["evaluation"]["returns"] = [[mean + seed] * 10 for mean in means]
            (run / "evaluation.json").write_text(json.dumps(result))
            keep([run], "low-quality", tmp_path / "kept")
    low = kept_scores("low-quality", tmp_path / "kept")
    assert low["dadt"]["Hopper"].tolist()[1] == [30.5, 30.5, 30.5, 5.5, 5.5]
    (claim,) = (claim for text, claim in verdicts(low=low).items() if text.startswith("On low-quality data"))
    assert (claim.evidence[0].what, claim.evidence[0].estimate.value) == ("DADT > DT", pytest.approx(0.6))
    (tmp_path / "kept/runs/low-quality" / run.name / "evaluation.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"has no evaluation\.json: keep the run again"):
        kept_scores("low-quality", tmp_path / "kept")


def test_fine_tuning_is_compared_with_the_same_agent_without_it():
    zero, adapted = entry("dadt-zero-shot-last", [60.0, 70.0, 80.0]), entry("dadt-adaptation-last", [90.0, 91.0, 92.0])
    claim = "Fine-tuning DADT for a dynamics makes it act better there"
    found = verdicts([zero, adapted])[claim]
    assert (found.verdict, found.evidence[0].what) == ("holds", "DADT, adapted > DADT")
    assert verdicts([zero])[claim].verdict == "not run"


def test_adapted_focal_is_no_part_of_the_papers_claim():
    found = verdicts()["DADT acts best after adaptation"]
    assert [one.what for one in found.evidence] == ["DADT > MerPO", "DADT > Trajectory Transformer"]


def test_weights_are_compared_on_the_robots_that_all_have(trained, tmp_path):
    scores = {("Hopper", 0.01): 90.0, ("Hopper", 0.05): 60.0, ("Hopper", 1.0): 30.0, ("Ant", 0.05): 99.0}
    for (robot, weight), score in scores.items():
        runs = [trained("dadt", seed, robot=robot, score=score + seed, next_state_weight=weight) for seed in range(3)]
        keep(runs, "next-state-weight", tmp_path / "kept")
    of = final_scores(kept_runs("next-state-weight", tmp_path / "kept"), "next_state_weight")
    found = verdicts(weights=of)[ROBUST]
    assert found.evidence[0].robots == ("Hopper",)
    assert "(0.01, 1.0)" in found.evidence[0].what  # and not 0.05, the best where others have not been run
    assert found.evidence[0].estimate.value == 60.0


def test_equal_weights_are_told_to_be_equal_where_runs_differ_little():
    rng = np.random.default_rng(0)

    def told(deviation, runs):
        groups = [{f"{v}": {"Hopper": rng.normal(50, deviation, (runs, 1))} for v in range(5)} for _ in range(40)]
        return [_robust(of).verdict for of in groups]

    assert told(1.0, 3).count("holds") > 30
    assert set(told(15.0, 3)) <= {"undecided", "does not hold"}


def test_few_mixed_runs_do_not_show_that_a_weight_does_not_matter(weights):
    groups = weights({0.01: [10.0, 50.0, 30.0], 1.0: [11.0, 49.0, 31.0]})
    assert verdicts(weights=groups)[ROBUST].verdict == "undecided"


def test_the_same_scores_show_that_a_weight_does_not_matter(weights):
    groups = weights({0.01: [30.0, 30.0, 30.0], 1.0: [30.0, 30.0, 30.0]})
    assert verdicts(weights=groups)[ROBUST].verdict == "holds"


def test_the_best_of_many_equal_values_is_not_taken_for_better():
    rng = np.random.default_rng(0)
    chances = []
    for _ in range(100):
        groups = {f"{value}": {"Hopper": rng.normal(50, 5, (3, 1))} for value in range(5)}
        chances.append(spread_by_chance(groups))
    # p-values of what is equal are uniform; best against worst alone would find a difference in more than half of these
    assert 0.01 <= np.mean(np.array(chances) < 0.05) <= 0.1
    assert 0.4 < np.mean(chances) < 0.6


def test_a_spread_by_chance_counted_by_hand():
    groups = {"a": {"Hopper": np.array([[1.0], [2.0]])}, "b": {"Hopper": np.array([[3.0], [4.0]])}}
    # of the 6 ways to deal four runs to two groups, 2 are as far apart as these
    assert spread_by_chance(groups) == pytest.approx(1 / 3, abs=0.02)


def test_who_does_the_same_in_every_run_is_not_better():
    same = [entry(f"{name}-zero-shot-last", [80.0, 90.0, 100.0]) for name in ("dadt", "dt")]
    equal = [entry(f"{name}-zero-shot-last", [80.0] * 3) for name in ("dadt", "dt")]
    assert verdicts(same)[BETTER].verdict == verdicts(equal)[BETTER].verdict == "undecided"
