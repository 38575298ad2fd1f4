"""Lets `python -m sfol.cli` be the command `sfol`."""

from sfol.cli import main

if __name__ == "__main__":
    main()
