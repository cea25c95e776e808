"""Many robots on emulated media, with faults."""
