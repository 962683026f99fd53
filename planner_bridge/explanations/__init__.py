"""Explanations: why a plan is as it is, why there is none, and why a run goes as it goes."""
