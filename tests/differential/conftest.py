"""PyReason is started once for all tests, and what it accepted is told at the end."""

import importlib
import os
from collections import Counter

import pytest
from hypothesis import HealthCheck, settings

from sfol import Facts, KnowledgeBase
from sfol.engines.pyreason import PyReasonEngine
from sfol.errors import MissingExtraError

_SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large]
settings.register_profile(
    "differential", max_examples=200, derandomize=True, deadline=None, suppress_health_check=_SLOW
)
settings.register_profile(
    "differential-long", max_examples=10_000, deadline=None, suppress_health_check=_SLOW
)

TALLY: dict[str, Counter[str]] = {}


@pytest.fixture(scope="session")
def pyreason():
    """The PyReason engine, ready. Its very first start on an installation takes minutes."""
    try:
        engine = PyReasonEngine(KnowledgeBase.load("aeb"))
    except MissingExtraError as error:
        if os.environ.get("SFOL_REQUIRE_PYREASON") == "1":
            pytest.fail(f"SFOL_REQUIRE_PYREASON is set, but {error}")
        pytest.skip(f"PyReason's tests did not run: {error}")
    engine.conclude(Facts.parse("NoCrosswalk(ego). EmptyLane(ego)."))
    return PyReasonEngine


@pytest.fixture(scope="session")
def runtime(pyreason):
    """The module that runs PyReason; it can't be imported where PyReason is missing."""
    return importlib.import_module("sfol.engines.pyreason_runtime")


@pytest.fixture(scope="session")
def library(pyreason):
    """PyReason itself."""
    return importlib.import_module("pyreason")


@pytest.fixture
def tally(request):
    """Counts that are printed when all tests are done."""
    return TALLY.setdefault(request.node.name, Counter())


def pytest_terminal_summary(terminalreporter):
    for name, counts in TALLY.items():
        shown = ", ".join(f"{count} {what}" for what, count in counts.items())
        terminalreporter.write_line(f"{name}: {shown}")
