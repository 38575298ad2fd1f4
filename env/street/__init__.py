"""The environment: world, perception and reward composed into Gymnasium's face.

May import `world` and `perception`.
"""
