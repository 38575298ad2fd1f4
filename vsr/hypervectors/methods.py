"""The ways to fuse SSI and SF by name, for those who name one without fusing: no torch here."""

from typing import Literal

Method = Literal["add", "multiply", "ssi", "sf"]
