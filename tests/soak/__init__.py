"""The long run (`make soak`): full load for minutes or hours, with all that can happen to a rig meanwhile."""
