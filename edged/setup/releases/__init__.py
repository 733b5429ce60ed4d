"""Releases of rig, cameras and jobs, and their activation."""
