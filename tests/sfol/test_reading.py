"""Why a file can't be read is said in one line that names the key."""

import pytest
from pydantic import BaseModel, ValidationError

from sfol.reading import first_reason


class Inner(BaseModel):
    count: int


class Outer(BaseModel):
    parts: list[Inner]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"parts": [{"count": 1}, {"count": "x"}]}', "parts.1.count: Input should be a valid int"),
        ("{}", "parts: Field required"),
        ("{", "Invalid JSON: EOF while parsing an object at line 1"),
    ],
)
def test_what_does_not_fit_is_named(text, reason):
    with pytest.raises(ValidationError) as caught:
        Outer.model_validate_json(text)
    assert first_reason(caught.value).startswith(reason)


def test_the_operating_system_s_reason_stands_without_its_number(tmp_path):
    with pytest.raises(OSError, match="Is a directory") as caught:
        tmp_path.read_bytes()
    assert first_reason(caught.value) == "Is a directory"


@pytest.mark.parametrize(
    ("error", "reason"),
    [(ValueError("first\nsecond"), "first"), (KeyError("k"), "'k'"), (ValueError(), "ValueError")],
)
def test_of_others_it_is_the_first_line(error, reason):
    assert first_reason(error) == reason
