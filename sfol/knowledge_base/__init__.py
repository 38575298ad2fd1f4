"""A knowledge base: a file that people edit, and the checked whole made from it.

`format` is what a user may write, `loading` reads files and what they extend, `checking` finds what
is wrong, `recursion` which heads depend on themselves, `model` is what the rest of sfol works with;
`printing`, `tables_view`, `formatting` and `schema` turn it back into text. May import sfol's
ground (errors, syntax, clauses, facts, formula, operators, writing) and nothing above. Others
import the names below from here, and functions from their modules.
"""

from sfol.knowledge_base.format import (
    FORMAT_VERSION,
    Case,
    CaseStep,
    EntityWeight,
    Expectation,
    Grounding,
    KnowledgeBaseFile,
    RuleEntry,
    Schedule,
    Semantics,
    Signal,
    Smoothing,
    Sort,
    Source,
    Term,
    Time,
    Weight,
)
from sfol.knowledge_base.model import KnowledgeBase
from sfol.knowledge_base.parts import (
    Attribute,
    EntityCondition,
    ObservedFact,
    Predicate,
    RewardTerm,
    Rule,
    ScheduledNumber,
)

__all__ = [
    "FORMAT_VERSION",
    "Attribute",
    "Case",
    "CaseStep",
    "EntityCondition",
    "EntityWeight",
    "Expectation",
    "Grounding",
    "KnowledgeBase",
    "KnowledgeBaseFile",
    "ObservedFact",
    "Predicate",
    "RewardTerm",
    "Rule",
    "RuleEntry",
    "Schedule",
    "ScheduledNumber",
    "Semantics",
    "Signal",
    "Smoothing",
    "Sort",
    "Source",
    "Term",
    "Time",
    "Weight",
]
