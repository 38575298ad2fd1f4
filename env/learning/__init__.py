"""How a policy learns: PPO over streets in their own processes.

May import all rooms up to `evaluation`. Whoever needs one function of it imports it late, since
stable-baselines3 and torch are slow to import.
"""
