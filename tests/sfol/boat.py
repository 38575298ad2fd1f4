"""A boat that drifts, and rules that read everything of a step: what wrappers are tested with."""

import gymnasium
import numpy as np

import sfol

DRIFT = """\
version: 1
name: drift
subject: boat
background: [Boat(boat)]
predicates:
  Boat(X): X is a boat.
  Far(X): X is far out.
rules:
  far: far(X) :- Boat(X), Far(X).
  out: far(X) :- Boat(X), Far(X) >= 0.7.
observation:
  boat: {key: [boat, 0], fields: [x, y]}
  age: {key: age}
  action: {}
facts_at: FACTS_AT
facts:
  Far(boat): above(hypot(boat.x, boat.y), 3, margin=2)
signals:
  way: {unit: m, from: "hypot(next.boat.x - boat.x, next.boat.y - boat.y)"}
  push: {unit: "1", from: action}
  lost: {unit: "1", from: terminated}
  late: {unit: "1", from: truncated}
  own: {unit: "1", from: native}
  age: {unit: "1", from: age}
weights:
  far: {normalizer: 1, coefficients: {far: 2.0}}
terms:
  far: {weight: far, formula: 1 + push}
  way: {weight: -1, formula: way}
  ending: {weight: 10, formula: lost + 3 * late + own}
  age: {weight: 1, formula: age}
"""

# What makes its rules speak of steps that have passed.
OVER_TIME = (
    ("rules:\n", "time: {step: 1, unit: s}\nrules:\n"),
    ("far(X) :- Boat(X), Far(X).", "far(X) :- Boat(X), once[3](Far(X))."),
    ("coefficients: {far: 2.0}", "coefficients: {far: 2.0}, smoothing: {rise: 0.5, fall: 2}"),
)


class Boat(gymnasium.Env):
    """A boat that drifts at random until it is too far out or too old; its arrays are reused."""

    observation_space = gymnasium.spaces.Dict(
        boat=gymnasium.spaces.Tuple([gymnasium.spaces.Box(-99, 99, (2,), np.float64)]),
        age=gymnasium.spaces.Discrete(100),
    )
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.age = self.np_random.normal(0.0, 1.0, 2), 0
        return self.observed(), {"begun": 1}

    def step(self, action):
        self.place += self.np_random.normal(0.3 * action, 1.0, 2)
        self.age += 1
        lost = bool(np.hypot(*self.place) > 4.0)
        return self.observed(), 0.1 * self.age, lost, self.age >= 9, {}

    def observed(self):
        return {"boat": (self.place,), "age": self.age}


def load(folder, facts_at="state", *changes):
    """Return the reward function, with some texts of the file replaced."""
    text = DRIFT.replace("FACTS_AT", facts_at)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "drift.yaml"
    path.write_text(text)
    return sfol.RewardFunction(path)
