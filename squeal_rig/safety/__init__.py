"""Watching the rig: limits, levels, latching, and the process that stops it from outside; nothing here speaks ROS."""
