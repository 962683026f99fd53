"""Many tasks at once: the task manager, preemption, the planning queue, interference of plans."""
