"""One goal or plan as a task: planning, execution, replanning, monitoring. `scheduling` runs many."""
