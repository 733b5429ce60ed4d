"""A job from one stereo pair and a region, or from a drawing."""
