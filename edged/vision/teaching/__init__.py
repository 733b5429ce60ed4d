"""Teaching: jobs from one stereo pair and a region, from a drawing or from a CAD model."""
