"""One robot on a bus: firmware, population, node, clock, and how it is driven in lockstep."""
