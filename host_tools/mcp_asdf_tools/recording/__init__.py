"""Recordings of a bus and of what each robot saw: written, read and replayed."""
