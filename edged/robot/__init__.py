"""The rig in the robot's frame, and orientations as controllers write them."""
