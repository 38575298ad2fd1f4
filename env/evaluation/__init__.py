"""How well somebody drives: episodes → metrics, results, returns; sweeps; in parallel.

May import all rooms up to `driving`.
"""
