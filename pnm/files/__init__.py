"""Reading files: text with positions, YAML with positions, suggestions for misspelt names."""
