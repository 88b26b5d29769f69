"""Fault test of the shared controller: what goes wrong in a real loop, done on purpose in every mode."""
