"""Starts the command `aeb`, or says in one line what it lacks."""

import sys

from sfol.errors import missing_extra


def main() -> None:
    """Run the command line of the bundled street."""
    try:
        from env.cli import main as run  # noqa: PLC0415  (what it imports may be missing)

        run()
    except ModuleNotFoundError as error:
        needed = "the bundled street needs it"
        print(
            f"aeb: {missing_extra(str(error.name), needed, extra='aeb', python='3.11')}",
            file=sys.stderr,
        )
        sys.exit(2)


if __name__ == "__main__":
    main()
