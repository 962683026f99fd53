"""Problem → plan: Kairos, other engines in processes, portfolios; validation of plans."""
