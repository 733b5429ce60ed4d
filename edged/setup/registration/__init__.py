"""Registration of the rig to the robot's frame."""
