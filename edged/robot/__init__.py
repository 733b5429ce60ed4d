"""The rig in the robot's frame, picking rules, and orientations as controllers write them."""
