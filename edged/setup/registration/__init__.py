"""The rig registered to the robot's frame."""
