"""Engines: facts in, conclusions out. All give the same conclusions.

`program` sorts a knowledge base's rules into strata, `plan` and `matching` find the substitutions
of one body in `tables` of facts, `support` reduces bodies that are trees, and `rounds` conclude
what depends on itself. `compiled` is the default, `batched` evaluates many scenes that `batch` has
encoded, `pyreason` is the slow reference: it translates scenes into the programs of
`pyreason_program`, which `pyreason_runtime` runs. What an engine returns are `conclusions`.
May import sfol's ground and `knowledge_base`.
"""
