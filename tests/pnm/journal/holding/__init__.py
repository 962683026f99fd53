"""Who may write a journal, and who waits for it."""
