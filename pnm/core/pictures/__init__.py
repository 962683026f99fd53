"""Pictures of plans, as SVG text that needs no other program."""
