"""Tests of the street."""

from tests import skip_without

skip_without("aeb", "torch", "gymnasium", "pyarrow", "pybullet", "stable_baselines3")
