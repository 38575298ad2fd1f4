"""The demo: recorded episodes, the most dangerous moment, and the report.

May import all rooms up to `learning`.
"""
