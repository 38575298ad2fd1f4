"""Vector Semantic Representation: from a segmentation map to entities, facts and hypervectors.

Importing this package loads nothing heavy; take what you need from its modules.
"""
