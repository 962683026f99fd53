"""Databases: an SQLite file, or tables in PostgreSQL, by the same statements."""
