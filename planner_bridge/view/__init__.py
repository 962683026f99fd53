"""The live page: what a journal tells, shown in a browser. It reads; what people may do there goes to the process that has the tasks."""
