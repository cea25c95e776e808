"""Many trials without a bus: parameters, engine, results, scores and plots."""
