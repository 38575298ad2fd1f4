"""Who drives: scripted drivers, policies and their files, setups, and the one loop they drive in.

May import `world`, `perception` and `street`.
"""
