"""What is seen: camera image or world state → entities, facts and descriptor vectors.

May import `world`.
"""
