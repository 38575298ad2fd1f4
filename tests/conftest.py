"""What all tests share."""

import os

import pytest
from hypothesis import HealthCheck, settings

# No test depends on time: how long an example takes says more about the machine than about us.
settings.register_profile("sfol", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("sfol")

if "PYTEST_XDIST_WORKER" in os.environ:
    # A process for each core: more threads would only wait for each other.
    os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep a file's tests in one process, where they share fixtures; PyReason's in one for all.

    PyReason compiles itself when it is first started on an installation, which takes minutes.
    """
    from xdist.scheduler import LoadScopeScheduling  # noqa: PLC0415  (not needed by a single process)

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return "PyReason" if "/differential/" in file else file

    # In the order of their names PyReason's come first and the street's next: those that take long.
    config.option.loadscopereorder = False
    return ByFile(config, log)


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
