"""Facts and signals, read off observations as a knowledge base says.

The sections `observation`, `entities` and `facts` and the signals with `from` are compiled once
into `plans`: which number, of which part of the observation, each name of a formula means. `single`
reads one scene into facts, `many` scenes along a leading axis into arrays. May import the ground
and `knowledge_base`.
"""
