"""Ground truth: arena, floor, sensors, which robots receive from which, and every random number."""
