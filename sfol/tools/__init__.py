"""What people do with knowledge bases: lint, compare, replay, draw, measure.

May import everything of sfol but `testing` and `cli`; nothing but `cli` imports it, and `vsr` and
`env` where they draw or measure as sfol does.
"""
