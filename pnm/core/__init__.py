"""The core: nets, logic, knowledge, machines and their execution, without I/O, clock or threads."""
