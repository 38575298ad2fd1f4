"""Tests of knowledge bases, and what holds engines against each other.

`cases` runs the `tests` of a file, `naive` is the definition by the letter, `strategies` draw
random knowledge bases and facts for hypothesis, and `laws` are what must hold for all of them. May
import everything of sfol but `tools` and `cli`.
"""
