"""Knowledge of a run: facts, state reports and sensors; `sources` answer what a run does not know itself."""
