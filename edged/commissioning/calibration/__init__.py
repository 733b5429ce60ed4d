"""From boards before both cameras to a rig, and whether one still holds."""
