"""Tests of perception."""

from tests import skip_without

skip_without("vsr", "torch", "scipy", "safetensors")
