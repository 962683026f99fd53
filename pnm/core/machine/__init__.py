"""Plan graph → Petri Net Machine: one block of places and transitions per step.

    orderings → (join) → ready → … → done → (fork) → orderings

Every block ends with exactly one token on `done`, whatever servers and the world answer. When
the step has failed there is one token on `failed` besides, which stays. A step that holds steps
marks the first places of their region, and goes on when all of its last ones are marked.
"""
