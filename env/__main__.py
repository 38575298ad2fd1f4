"""Starts the command `aeb`, or says in one line what it lacks."""

import sys

from sfol.errors import MissingExtraError


def main() -> None:
    """Run the command line of the bundled street."""
    try:
        from env.cli import main as run  # noqa: PLC0415  (what it imports may be missing)
    except MissingExtraError as error:
        sys.exit(f"aeb: {error}")
    except ModuleNotFoundError as error:
        hint = "python -m pip install 'sfol[aeb]' on Python 3.11"
        sys.exit(f"aeb: the bundled street needs {error.name} ({hint})")
    run()


if __name__ == "__main__":
    main()
