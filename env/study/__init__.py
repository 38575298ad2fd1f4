"""The paper's study: every setup trained and driven, resumably; its tables and figures.

May import all rooms up to `learning`.
"""
