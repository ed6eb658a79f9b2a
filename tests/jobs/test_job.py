"""What a job may be, and what its key depends on."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynagen_bench.jobs import Job, run_jobs
from dynagen_bench.jobs.job import check_jobs

plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def job(**changes):
    return Job(**{"name": "a", "function": "m.n:f", "arguments": {}, "outputs": ("a/b.txt",), "total": 1, **changes})


@given(arguments=st.dictionaries(st.text(min_size=1), plain, max_size=4))
def test_a_key_is_of_what_is_done_and_not_of_how_it_is_written(arguments):
    one = job(arguments=arguments)
    assert one.key == job(arguments=dict(reversed(arguments.items())), name="b", total=7).key
    assert len({one.key, job(arguments={**arguments, "": 0}).key, job(function="m.n:g", arguments=arguments).key}) == 3
    assert one.key != job(arguments=arguments, outputs=("a/c.txt",)).key


def test_keys_are_frozen():
    assert job(arguments={"x": [1, 2.5, None]}).key == PINNED_KEY


PINNED_KEY = "2216fadbfed095be92325d33faeb0e14d66854eab48c9693c51d59f8945e1f16"
"""Another key would run again what users have done."""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"function": "m.n"}, r"function is 'm.n': give 'package.module:function'"),
        ({"function": "__main__:f"}, r"which a fresh process can import"),
        ({"arguments": {"x": (1, 2)}}, r"no plain JSON data.*\(1, 2\)"),
        ({"arguments": {"x": float("nan")}}, r"no plain JSON data"),
        ({"arguments": {"x": {1: 2}}}, r"no plain JSON data"),
        ({"arguments": {"x": print}}, r"no plain JSON data"),
        ({"outputs": ()}, r"outputs are \(\): give at least one path"),
        ({"outputs": ("a", "a")}, r"each once"),
        ({"outputs": ("../a",)}, r"relative to the folder of the results and inside it"),
        ({"outputs": ("/a",)}, r"relative"),
        ({"outputs": ("a/./b",)}, r"relative"),
        ({"outputs": (".jobs/a",)}, r"relative"),
        ({"outputs": ("",)}, r"relative"),
        ({"total": 0}, r"job 'a': total is 0: give a whole number from 1 on"),
        ({"total": 2.5}, r"job 'a': total is 2.5: give a whole number from 1 on"),
    ],
)
def test_what_is_no_job_is_refused_in_one_line(changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        job(**changes)
    assert "\n" not in str(caught.value)


def test_jobs_that_would_be_taken_for_one_another_are_refused(tmp_path):
    with pytest.raises(ValueError, match="two jobs have the name 'a'"):
        check_jobs([job(), job(outputs=("c",))])
    with pytest.raises(ValueError, match=r"jobs 'a' and 'b' both make a/b\.txt"):
        run_jobs([job(), job(name="b", arguments={"x": 1})], tmp_path)
    for number in (0, 1.5, True):
        with pytest.raises(ValueError, match=f"processes is {number}: give a whole number from 1 on"):
            run_jobs([job()], tmp_path, processes=number)
