"""Braces mean what they mean to bash."""

import subprocess

from hypothesis import given, settings
from hypothesis import strategies as st

from agents.braces import expand

WORDS = st.text("abc-0=. ", max_size=4)
RANGES = st.builds("{{{}..{}}}".format, st.integers(-12, 12), st.integers(-12, 12))
TEXTS = st.recursive(
    WORDS | RANGES,
    lambda inner: st.one_of(
        st.lists(inner, min_size=2, max_size=3).map(lambda parts: "{" + ",".join(parts) + "}"),
        st.lists(inner, min_size=1, max_size=2).map("".join),
        WORDS.filter(lambda word: "," not in word).map("{{{}}}".format),
    ),
    max_leaves=4,
)


def by_bash(texts):
    """What bash makes of each text as one word, spaces quoted."""
    words = [text.replace(" ", "\\ ") for text in texts]
    script = "\n".join(f"printf '%s\\0' x{word}; printf '\\1'" for word in words)
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    return [[found.removeprefix("x") for found in part.split("\0")[:-1]] for part in done.stdout.split("\1")[:-1]]


def test_simple_cases():
    assert list(expand("{a,b} {0..2}")) == ["a 0", "a 1", "a 2", "b 0", "b 1", "b 2"]
    assert list(expand("x{,-{1,2}}")) == ["x", "x-1", "x-2"]
    assert list(expand("{2..0}")) == ["2", "1", "0"]
    for plain in ("", "a b", "{a}", "{", "}", "a}b{", "{01..3}"):
        assert list(expand(plain)) == [plain]
    assert list(expand("{{a,b}")) == ["{a", "{b"]


def test_a_range_takes_no_memory():
    endless = expand("{0..1000000000000} {1..1000000000}")
    assert [next(endless), next(endless)] == ["0 1", "0 2"]


@settings(max_examples=20, deadline=None)
@given(st.lists(TEXTS, min_size=20, max_size=20))
def test_it_is_what_bash_does(texts):
    assert [list(expand(text)) for text in texts] == by_bash(texts)


@given(st.lists(st.lists(WORDS, min_size=2, max_size=4), max_size=3))
def test_every_choice_is_made_once_with_every_other(choices):
    found = list(expand("".join("{" + ",".join(some) + "};" for some in choices)))
    wanted = [""]
    for some in choices:
        wanted = [begun + one + ";" for begun in wanted for one in some]
    assert found == wanted
