"""PyReason's start in a new process: it finds its cache and adds nothing to it."""

import pytest

from sfol.tools.bench_pyreason import ready, ready_compared

pytest.importorskip("pyreason")


@pytest.mark.long
def test_a_new_process_finds_the_cache_and_adds_nothing():
    assert ready()["cache_growth_bytes"] == 0


@pytest.mark.long
def test_only_the_ordinary_way_to_register_functions_lets_the_cache_grow():
    figures = ready_compared()
    assert figures["warm_cache_growth_bytes"] == 0
    assert figures["ordinary_cache_growth_bytes"] > 1_000_000
