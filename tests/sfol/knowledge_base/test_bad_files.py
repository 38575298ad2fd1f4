"""Mutated files: whatever is wrong with a file, the error is one of ours, with a place."""

import random

import pytest

from sfol import KnowledgeBase, RewardFunction
from sfol.errors import InvalidKnowledgeBase
from sfol.knowledge_base.loading import bundled_folder

TEXT = (bundled_folder() / "aeb.yaml").read_text()
PIECES = ["[", "]", "{", "}", ":", "- ", "&a ", "*a", "!!int ", "|", ">", "'", '"', "#", "\n", "\t",
          "not ", "!= ", ".nan", ".inf", "-1", "1e999", "null", "true", "Vehicle(X)", ":-", "é", "\x07",
          "ego", "((", "))", ",", "%", "0x1F", "2020-01-01", "~", "?", "<<: ", "\u2028"]  # fmt: skip


def mutated(chance):
    text = TEXT
    for _ in range(chance.randint(1, 4)):
        start = chance.randrange(len(text))
        end = min(start + chance.choice([0, 0, 1, 1, 3, 30]), len(text))
        text = text[:start] + chance.choice([*PIECES, "", ""]) + text[end:]
    return text


def load(path, seed):
    path.write_text(mutated(random.Random(seed)), encoding="utf-8")
    try:
        RewardFunction(KnowledgeBase.load(path))
    except InvalidKnowledgeBase as invalid:
        return invalid.errors
    return ()


@pytest.mark.parametrize("first", range(0, 200, 20))
def test_mutated_files_raise_nothing_else(tmp_path, first):
    path = tmp_path / "aeb.yaml"
    for seed in range(first, first + 20):
        for error in load(path, seed):
            assert error.place is not None, (seed, error)
            assert error.place.file == str(path)


@pytest.mark.long
def test_ten_thousand_mutated_files_raise_nothing_else(tmp_path):
    path = tmp_path / "aeb.yaml"
    broken = sum(any(load(path, seed)) for seed in range(10_000))
    assert broken > 5_000
