"""Controls of the page: what people want there, who may want it, and how it reaches the process that has the tasks."""
