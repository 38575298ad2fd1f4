"""What developers run: frames to train networks on, comparisons, profiles, benchmarks.

May import all other rooms but `cli`.
"""
