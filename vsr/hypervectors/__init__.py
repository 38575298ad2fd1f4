"""Entities and features → hypervectors, and back.

`hrr` is the algebra, `codebook` the symbols, `attention` and `fusion` combine with features, and
`descriptor` makes the vector of a scene; `decoding` reads it, `capacity` measures how much fits in.
May import `sfol` and the modules at the top of `vsr`; no networks.
"""
