"""The live page: what a journal tells, shown in a browser. It reads, and changes nothing."""
