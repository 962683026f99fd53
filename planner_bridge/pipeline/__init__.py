"""From files to a result: problems are loaded, goals and plans carried out."""
