"""How `aeb` ends when something goes wrong that nobody foresees."""

import errno
from importlib import import_module

import pytest

module = import_module("env.cli.app")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (
            PermissionError(errno.EACCES, "Permission denied", "a file"),
            "'a file': Permission denied",
        ),
        (OSError("no number"), "no number"),
    ],
)
def test_what_the_system_refuses_is_an_error_without_a_traceback(monkeypatch, capsys, error, text):
    def refused(**_):
        raise error

    monkeypatch.setattr(module, "app", refused)
    with pytest.raises(SystemExit) as ended:
        module.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"error: {text}\n"
