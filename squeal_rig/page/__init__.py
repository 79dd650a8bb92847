"""The operator's page: a web server, and what it may be asked for. Nothing here speaks ROS."""
