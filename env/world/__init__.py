"""The world: a street in pybullet, what moves on it, and the camera that looks at it.

Knows nothing of rules, rewards or learning. The first room of `env`: it imports none of the others,
and they import it.
"""
