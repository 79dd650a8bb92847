"""Drivers beside the virtual rig: a recorded run as if it were the rig, and hardware."""
