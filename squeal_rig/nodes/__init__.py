"""Thin ROS 2 shells: parameters in, a pure call, a message out."""
