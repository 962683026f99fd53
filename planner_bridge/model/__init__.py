"""The model of a planning problem: domain, problem, plan, grounding, plan simulation."""
