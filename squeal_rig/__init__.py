"""Virtual test rig for brake squeal: model, instruments, estimation and ROS 2 nodes."""

__version__ = "0.1.0"
