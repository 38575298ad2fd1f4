"""Reading takes time in proportion to the file: twice the text is at most two and a half the work."""

from contextlib import suppress

import pytest

from sfol import KnowledgeBase
from sfol.errors import InvalidKnowledgeBase
from tests.sfol.work import calls

HEAD = """\
version: 1
name: big
predicates: {{P(X): a, Q(X): b{more}}}
rules:
  r: h(X) :- P(X), Q(X).
{rules}
signals: {{v: {{unit: m/s}}}}
weights: {{w: {{normalizer: 1, coefficients: {{h: 1}}}}}}
terms: {{t: {{weight: w, formula: v}}}}
"""


def predicates(count):
    return HEAD.format(more="".join(f", P{i}(X): p" for i in range(count)), rules="")


def rules(count):
    return HEAD.format(more="", rules="".join(f"  r{i}: h(X) :- P(X).\n" for i in range(count)))


def misspelt(count):
    return HEAD.format(more="", rules="".join(f"  r{i}: h(X) :- PP(X).\n" for i in range(count)))


def unparsed(count):
    return HEAD.format(more="", rules="".join(f"  r{i}: h(X) -\n" for i in range(count)))


def unknown_keys(count):
    return HEAD.format(more="", rules="") + "".join(f"k{i}: 1\n" for i in range(count))


def work(path, text):
    path.write_text(text)

    def load():
        with suppress(InvalidKnowledgeBase):
            KnowledgeBase.load(path)

    return calls(load)


@pytest.mark.parametrize("make", [predicates, rules, misspelt, unparsed, unknown_keys])
def test_twice_the_file_is_about_twice_the_work(tmp_path, make):
    path = tmp_path / "big.yaml"
    work(path, make(10))  # what happens once
    once, twice = work(path, make(150)), work(path, make(300))
    assert twice < 2.5 * once


def test_an_overlay_is_merged_in_proportion(tmp_path):
    (tmp_path / "big.yaml").write_text(predicates(300))
    overlay = "version: 1\nname: o\nextends: big\npredicates: {{{}}}\n"

    def text(count):
        return overlay.format(", ".join(f"P{i}(Y): p" for i in range(count)))

    work(tmp_path / "o.yaml", text(10))
    base = work(tmp_path / "o.yaml", text(0))
    once, twice = (work(tmp_path / "o.yaml", text(n)) - base for n in (150, 300))
    assert twice < 2.5 * once


def test_errors_end_after_a_hundred(tmp_path):
    path = tmp_path / "big.yaml"
    path.write_text(misspelt(1000))
    with pytest.raises(InvalidKnowledgeBase) as caught:
        KnowledgeBase.load(path)
    assert len(caught.value.errors) == 100
