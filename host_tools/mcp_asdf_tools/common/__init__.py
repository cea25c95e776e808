"""Errors, files, signals, parameters and figures: what any program needs. Knows nothing of robots."""
