"""Where the rig stands to the robot: by touched points, or by poses."""
