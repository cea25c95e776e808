"""Ground truth: arena, floor, sensors, who hears whom, and every random number."""
