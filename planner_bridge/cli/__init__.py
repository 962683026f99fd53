"""The `pnm` command."""
