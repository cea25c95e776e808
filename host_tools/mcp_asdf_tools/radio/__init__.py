"""Emulated neighbours of one real controller, and the verdict on it."""
