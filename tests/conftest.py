"""What all tests share."""

import pytest
from hypothesis import HealthCheck, settings

# No test depends on time: how long an example takes says more about the machine than about us.
settings.register_profile("sfol", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("sfol")


def pytest_addoption(parser):
    parser.addoption(
        "--passed-at-least",
        type=int,
        default=0,
        metavar="N",
        help="fail if fewer tests pass, as when most of them are skipped",
    )


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session):
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    least = session.config.getoption("passed_at_least")
    if reporter and len(reporter.stats.get("passed", ())) < least:
        reporter.write_line(f"\nfewer than {least} tests passed", red=True)
        session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED
