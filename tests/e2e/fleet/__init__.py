"""Several nodes with one journal in PostgreSQL, one of which serves."""
