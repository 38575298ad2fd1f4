"""Fuzzing: readers of files and texts are given bytes that nobody would write.

`make fuzz` looks for such bytes guided by coverage, with Atheris, for some minutes a reader; the
tests beside this file give every reader some that are drawn by chance.
"""
