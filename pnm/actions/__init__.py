"""Clients that carry out actions: the protocol, and simulated robots."""
