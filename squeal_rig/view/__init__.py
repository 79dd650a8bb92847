"""What people see and hear of the rig, small enough for any screen."""
