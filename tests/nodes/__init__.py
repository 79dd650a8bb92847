"""Facts about the nodes: real processes on a private ROS domain, met by an observer in the test's own process."""
