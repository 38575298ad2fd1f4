"""Scenes of facts as blocks for the dense engine, with the entities in one or in several sorts."""

import numpy as np

from sfol.arrays import backend_of
from sfol.engines.batched import Bounds
from sfol.engines.dense import DenseProgram, Domains
from sfol.engines.program import Program
from sfol.syntax import Atom, is_variable


def blocks_of(program, scenes, sorts):
    """Return the domains, and every scene's atoms in blocks."""
    kb = program.knowledge_base
    named = [name for facts in scenes for name in facts.entities()]
    named += [kb.subject, *(a for atom in kb.background for a in atom.arguments)]
    rules = kb.rules.values()
    named += [
        a
        for r in rules
        for a in r.clause.body.terms + r.clause.head.arguments
        if not is_variable(a)
    ]
    names = list(dict.fromkeys(named))
    split = {f"s{i}": tuple(names[i::sorts]) for i in range(sorts)}
    domains = Domains.of(kb, {sort: members for sort, members in split.items() if members})
    blocks = {}
    for scene, facts in enumerate(scenes):
        for (predicate, arguments), bound in program.tables(facts).items():
            key = (predicate, domains.axes(arguments))
            if key not in blocks:
                shape = (*(domains.sizes[axis] for axis in key[1]), len(scenes))
                blocks[key] = Bounds(np.zeros(shape), np.zeros(shape), np.zeros(shape, bool))
            at = (*(domains.places[name][1] for name in arguments), scene)
            blocks[key].lower[at], blocks[key].upper[at], blocks[key].known[at] = *bound, True
    return domains, blocks


def dense_conclusions(kb, scenes, sorts=1, make=np.asarray):
    """Return for each scene what the dense engine concludes: atom → bound."""
    program = Program.of(kb)
    domains, blocks = blocks_of(program, scenes, sorts)
    blocks = {key: Bounds(make(b.lower), make(b.upper), make(b.known)) for key, b in blocks.items()}
    dense = DenseProgram(program, domains, blocks)
    backend = backend_of([array for b in blocks.values() for array in (b.lower, b.upper)])
    found = dense.conclude(blocks, backend, domains.sizes)
    members = {}
    for name, (domain, _) in domains.places.items():
        members.setdefault(domain, []).append(name)
    conclusions = [{} for _ in scenes]
    for (predicate, axes), b in found.items():
        if predicate not in kb.heads:
            continue
        shape = (*(domains.sizes[axis] for axis in axes), len(scenes))
        lower, upper, known = (
            np.broadcast_to(np.asarray(a), shape) for a in (b.lower, b.upper, b.known)
        )
        for at in zip(*np.nonzero(known), strict=True):
            *places, scene = at
            names = tuple(members[axis][place] for axis, place in zip(axes, places, strict=True))
            conclusions[scene][Atom(predicate, names)] = (float(lower[at]), float(upper[at]))
    return conclusions


def asked(program, atoms, facts):
    """Return what the engine is asked for: heads that others read, and the subject's."""
    subject = (program.knowledge_base.subject,)
    return {
        atom: bound
        for atom, bound in atoms.items()
        if not program.for_subject_alone(atom.predicate) or atom.arguments == subject
    }
