"""From a pair that shows a part to a job."""
