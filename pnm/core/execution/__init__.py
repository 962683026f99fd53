"""One run of a machine: guards, requests, results, resources, hand-over; the executor connects it to a clock and a client."""
