"""What commands print: texts that are safe, lines of events, a run, the tasks of a node."""
