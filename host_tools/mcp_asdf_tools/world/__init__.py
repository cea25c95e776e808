"""Ground truth: arena, floor, sensors and their calibration, who hears whom, and every random number."""
