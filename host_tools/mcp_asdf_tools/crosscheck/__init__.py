"""The C firmware against its mirror, float64 and exact arithmetic."""
