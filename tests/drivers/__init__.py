"""Drivers beside the virtual one, the twin of the hardware, the contract suite."""
