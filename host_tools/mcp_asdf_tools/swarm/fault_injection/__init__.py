"""Faults of nodes and of the links between them, injected so that a run can be repeated to the bit.

``kinds`` has one class for each kind of fault: its options, its help and what it does. ``faults`` applies
all faults of a run, and ``parsing`` reads a fault from text.
"""
