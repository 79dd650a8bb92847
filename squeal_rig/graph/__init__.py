"""Adapters between our objects and the ROS graph, shared by the nodes."""
