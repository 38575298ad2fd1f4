"""A rule-based reward in a loop of your own: no Gymnasium, no simulator, just facts and numbers.

A car drives towards a pedestrian on the road, brakes, waits for them to leave, and goes on.
Run it: python examples/plain_loop.py
"""

import sfol

reward = sfol.RewardFunction("aeb")  # or the path of a file of your own
x, v, total = 0.0, 8.0, 0.0  # position in m, speed in m/s
for step in range(120):
    facts = reward.facts()
    someone = step < 60  # the pedestrian leaves after six seconds
    if someone:
        facts.add("Pedestrian", "p1", confidence=0.9)
        facts.add("OnRoad", "p1")
        facts.add("CenterOf", "p1", "ego")
    else:
        facts.add("NoCrosswalk", "ego")
        facts.add("EmptyLane", "ego")
    v_next = max(v - 0.3, 0.0) if someone and x > 8.0 else min(v + 0.2, 8.0)
    outcome = reward.evaluate(facts, v=v, v_next=v_next, d=30.0 - x if someone else float("inf"))
    total += outcome.reward
    if step % 20 == 0:
        print(f"{step / 10:4.1f} s  {v:4.1f} m/s  {outcome.reward:+.3f}  {dict(outcome.weights)}")
    x, v = x + 0.1 * v_next, v_next
print(f"return {total:.2f}\n\nwhy the last reward:\n{reward.explain(facts, v=v, v_next=v)}")
