"""Errors, files, signals, parameters and figures, as any program needs them: nothing here is about robots."""
