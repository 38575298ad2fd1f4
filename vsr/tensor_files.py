"""Safetensors files and the cards beside them: what they say of themselves is compared first.

A file of tensors says in its header what it holds, and that is compared with what it should hold
before anything is loaded or built. Its card says which file it belongs to, by SHA-256.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, NamedTuple, TypeVar

import torch
from pydantic import BaseModel, Field
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor

from sfol.errors import FileError
from sfol.reading import opened
from sfol.writing import replacing
from vsr.json_files import read_json

Model = TypeVar("Model", bound=BaseModel)
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

MOST_OF_CARD = 1_000_000  # bytes; the longest that is shipped has 5 000
_FLOATS = {"F16", "BF16", "F32"}
_TOGETHER = "take both from one place, or train again"


class TensorKind(NamedTuple):
    """What a tensor is, without its numbers: whether they are floating-point, and their shape."""

    floating: bool
    shape: tuple[int, ...]

    def __str__(self) -> str:
        return f"{'floats' if self.floating else 'integers'} of shape {self.shape}"


class Header(NamedTuple):
    """What a file says of itself: texts by name, and each tensor's type and shape."""

    metadata: Mapping[str, str]
    tensors: Mapping[str, tuple[str, tuple[int, ...]]]


def kinds_of(state: Mapping[str, Tensor]) -> dict[str, TensorKind]:
    """Return what the tensors of a state are."""
    return {
        name: TensorKind(tensor.is_floating_point(), tuple(tensor.shape))
        for name, tensor in state.items()
    }


def read_header(file: Path | str) -> Header:
    """Return what a file says of itself; no tensor is loaded.

    Raises:
        FileError: the file can't be read.
    """
    opened(Path(file), "file of tensors").close()  # no pipe, which would be waited for
    try:
        with safe_open(file, framework="pt") as header:
            slices = {name: header.get_slice(name) for name in header.keys()}  # noqa: SIM118
            tensors = {n: (s.get_dtype(), tuple(s.get_shape())) for n, s in slices.items()}
            return Header(header.metadata() or {}, tensors)
    except (OSError, SafetensorError) as error:
        raise FileError(f"'{file}' can't be read: {error}", name=str(file)) from None


def misfit(header: Header, expected: Mapping[str, TensorKind]) -> str | None:
    """Return in what a file differs from what it should hold; None if in nothing.

    Args:
        header: of the file.
        expected: what each tensor should be. Floats are float16, bfloat16 or float32, and integers
            int64.
    """
    for name in sorted(header.tensors.keys() ^ expected.keys()):
        return f"it has {'no' if name in expected else 'a'} tensor '{name}'"
    for name, kind in expected.items():
        dtype, shape = header.tensors[name]
        if shape != kind.shape or dtype not in (_FLOATS if kind.floating else {"I64"}):
            return f"'{name}' is {dtype} of shape {shape}, not {kind}"
    return None


def load_finite(file: Path | str) -> dict[str, Tensor]:
    """Return the tensors of a file whose header fits, its floats as float32.

    Raises:
        FileError: the file can't be read, or one of its numbers is not finite.
    """
    try:
        tensors = load_file(file)
    except (OSError, SafetensorError) as error:
        raise FileError(f"'{file}' can't be read: {error}", name=str(file)) from None
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise FileError(f"'{file}' has numbers in '{name}' that aren't finite", name=str(file))
    return {name: t.float() if t.is_floating_point() else t for name, t in tensors.items()}


def sha256(content: bytes) -> str:
    """Return the SHA-256 of a file's content, 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def check_belongs(file: Path, digest: str | None, card: Path) -> None:
    """Refuse a file that is not the one that its card was written for.

    Args:
        file: of tensors.
        digest: the SHA-256 that the card names; None if it names none.
        card: path of the card.

    Raises:
        FileError: it is another one, or can't be read.
    """
    with opened(file, "file of tensors") as content:
        found = hashlib.file_digest(content, "sha256").hexdigest()
    if digest is None:
        raise FileError(
            f"'{card}' does not say which file it belongs to", name=str(card), suggestion=_TOGETHER
        )
    if digest != found:
        raise FileError(
            f"'{file}' is not the file that '{card}' was written for",
            name=str(file),
            suggestion=f"{_TOGETHER}; the SHA-256 is {found[:12]}…, and the card names "
            f"{digest[:12]}…",
        )


def read_card(path: Path, kind: type[Model], what: str) -> Model:
    """Return a card.

    Args:
        path: of the JSON file.
        kind: what it says.
        what: it is called, such as ``card of a policy``.

    Raises:
        FileError: there is none, it is too large, or it is not valid.
    """
    return read_json(path, kind, what, most=MOST_OF_CARD)


def write_card(card: BaseModel) -> bytes:
    """Return a card as it is written."""
    return (card.model_dump_json(indent=2) + "\n").encode()


def write_together(contents: dict[Path, bytes]) -> None:
    """Write files that belong together.

    None takes its place before all are written, so that a full disk leaves the old ones; then they
    take them one after the other, the first one first.

    Args:
        contents: of each file; a card comes last.

    Raises:
        UsageError: one can't be written.
    """
    with ExitStack() as stack:
        # A stack is left from its end.
        for path, content in reversed(contents.items()):
            stack.enter_context(replacing(path)).write_bytes(content)
