"""Frames on CAN: codec, DBC, bus load, python-can interfaces, an slcan adapter."""
