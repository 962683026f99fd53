"""The language: domains and plans that people write in YAML. Knows nothing of planners."""
