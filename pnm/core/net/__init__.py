"""Petri nets: the net, the firing rule as it is defined (the oracle), and the firing engine."""
