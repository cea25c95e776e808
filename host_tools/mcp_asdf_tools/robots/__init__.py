"""One robot on a bus: firmware, its sensor calibrated, population, node, clock, and lockstep."""
