"""The write-ahead journal: what happens to runs, written down before anything is done about it; and its replay."""
