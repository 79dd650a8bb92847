"""What each error of a rig's instruments does to the estimated friction coefficient."""
