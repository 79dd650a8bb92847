"""Faults injected into a running rig and its nodes; what is to become of each is in `matrix`."""
