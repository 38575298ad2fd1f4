"""A knowledge base that reads its facts off observations: a robot among people in a hall."""

HALL = """\
version: 1
name: hall
subject: robot
background: [Robot(robot)]
grounding: {margin: 0.05}
predicates:
  Robot(X): X is a robot.
  Person(X): X is a person.
  Close(X, Y): X is close to Y.
  Ahead(X, Y): X is ahead of Y.
  Beside(X, Y): X and Y stand together.
rules:
  careful: careful(X) :- Robot(X), Person(P), Close(P, X), Ahead(P, X).
  crowded: crowded(X) :- Robot(X), Person(P), Person(Q), Beside(P, Q), P != Q.
observation:
  people: {key: people, fields: [x, y], present: mask}
  robot: {key: [body, state], fields: {x: 0, y: 1, speed: 3}}
  light: {key: light}
  action: {fields: [throttle]}
entities:
  person: {from: people, at_most: 4}
facts:
  Person(P in person): 1.0
  Close(P in person, robot):
    formula: below(hypot(P.x - robot.x, P.y - robot.y), 2, margin=4)
    at_least: 0.3
  Ahead(P in person, robot): {formula: P.x >= robot.x, bounds: exact}
  Beside(P in person, Q in person): near(hypot(P.x - Q.x, P.y - Q.y), 0, margin=2)
signals:
  v: {unit: m/s, from: robot.speed}
  v_next: {unit: m/s, from: next.robot.speed}
  push: {unit: "1", from: action.throttle}
  dark: {unit: "1", from: 1 - light}
  limit: {unit: m/s, default: 2.0}
weights:
  care: {normalizer: 1, coefficients: {careful: 1.0}}
  crowd: {normalizer: 1, coefficients: {crowded: 1.0}}
terms:
  haste: {weight: care, formula: -v**2 - limit}
  comfort: {weight: 1, formula: -(v - v_next)**2 - push**2 - dark}
  crowd: {weight: crowd, formula: -1}
"""
OBSERVATION = {
    "people": [[1.0, 0.0], [5.0, 0.0], [1.0, 1.0], [float("nan"), 0.0]],
    "mask": [True, True, True, False],
    "body": {"state": [0.0, 0.0, 99.0, 3.0]},
    "light": 0.75,
}
NEXT = {"body": {"state": [0.0, 0.0, 99.0, 2.0]}}
ACTION = [0.5]
