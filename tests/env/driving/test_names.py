"""Names from files lead nowhere."""

from pathlib import Path, PurePosixPath, PureWindowsPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.driving.names import MOST, checked_name, name_like
from env.driving.setup import setup_names, training_name
from sfol.errors import SfolError

PARTS = st.sampled_from(
    ["..", ".", "/", "\\", "a", "-", "0", "\n", "\0", ":", "~", "$HOME", "ä", " "]
)
TEXTS = st.text() | st.lists(PARTS, max_size=9).map("".join)


@given(TEXTS)
def test_a_checked_name_is_one_part_of_a_path(text):
    try:
        name = checked_name(text)
    except SfolError:
        return
    assert name == text
    for kind in (PurePosixPath, PureWindowsPath):
        assert kind(name).parts == (name,)
    assert (Path("/results") / name).resolve() == Path("/results", name)
    assert len(name) <= MOST
    assert name[0] not in ".-=+@"


@given(TEXTS)
def test_every_text_has_a_name_that_is_like_it(text):
    assert checked_name(name_like(text)) == name_like(text)
    assert checked_name(f"{name_like(text)}-0123456789ab")


@pytest.mark.parametrize("setup", setup_names())
def test_names_of_trainings_are_left_as_they_are(setup):
    name = training_name(setup.replace("/", "_"), 0)
    assert checked_name(name) == name == name_like(name)


@pytest.mark.parametrize(
    "text",
    ["", ".", "..", ".hidden", "-rf", "a/b", "a\\b", "x/../../../../ESCAPED", "a\n", "a" * 129],
)
def test_what_is_no_name_is_an_error_that_says_what_one_is(text):
    with pytest.raises(SfolError, match="letters, digits") as caught:
        checked_name(text)
    assert str(caught.value).isprintable()
