"""Fuzzes one reader, guided by coverage: ``python -m tests.fuzz READER FOLDER [MINUTES]``.

The folder keeps the inputs that reached something new, and those that crashed; a further run goes
on from them. It needs Atheris, which `make fuzz` installs.
"""

import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["sfol", "yaml"]):
    from tests.fuzz.readers import READERS
    from tests.fuzz.seeds import seeds


def main() -> None:
    """Fuzz until the time is over or something is found."""
    name, folder, *rest = sys.argv[1:]
    corpus = Path(folder) / name
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(seeds(name)):
        (corpus / f"seed-{number}").write_bytes(seed)
    seconds = round(60 * float(rest[0] if rest else 1))
    options = [
        f"-max_total_time={seconds}", "-timeout=20", "-rss_limit_mb=4096", "-max_len=20000",
        "-print_final_stats=1", f"-artifact_prefix={folder}/{name}-",
    ]  # fmt: skip
    atheris.Setup([sys.argv[0], *options, str(corpus)], READERS[name])
    atheris.Fuzz()


main()
